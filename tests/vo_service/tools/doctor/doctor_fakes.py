"""Configurable computers, sensors and camera streams for tests of the checks."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from drivers.calibration import KINECT_READOUT_S, KINECT_TIMING_PRIOR
from drivers.camera import CameraCounters, PinholeCamera, RgbdFrame, new_images
from drivers.kinect_usb.usb_ids import SensorModel
from vo_service.tools.doctor.camera_checks import requested_camera
from vo_service.tools.doctor.check import CheckContext
from vo_service.tools.doctor.stream_probe import StreamSample
from vo_service.tools.doctor.usb_probe import UsbPart, UsbSensor

PERIOD_S = 1 / 30


def make_sensor(
    model: SensorModel = SensorModel.K1414, address: int = 4, **facts: Any
) -> UsbSensor:
    """Make a sensor on bus 1 without faults, except for `facts`."""
    defaults: dict[str, Any] = {
        "camera": UsbPart(1, address),
        "others": (UsbPart(1, address + 1),),
        "where": "bus 1 port 2.1",
        "speed_mbit_s": 480.0,
        "has_kernel_driver": False,
    }
    return UsbSensor(model=model, **(defaults | facts))


CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)


def make_samples(count: int = 60, **changes: Callable[[int], Any]) -> tuple[RgbdFrame, ...]:
    """Make frames of a good camera; ``skew_s=lambda k: ...`` changes one field of frame k."""
    defaults: dict[str, Callable[[int], Any]] = {
        "seq": lambda k: k,
        "stamp_s": lambda k: 100.0 + k * PERIOD_S,
        "receive_time_s": lambda k: 100.03 + k * PERIOD_S,
        "device_stamp_s": lambda k: 7.0 + k * PERIOD_S,
        "skew_s": lambda k: 0.004,
        "gravity_m_s2": lambda k: (0.0, 9.81, 0.0),
        "readout_s": lambda k: KINECT_READOUT_S,
        "timing_prior": lambda k: KINECT_TIMING_PRIOR,
        "serial": lambda k: "A00123456789012A",
        "camera": lambda k: CAMERA,
    }
    fields = defaults | changes
    no_color, no_depth = new_images(0, 0)
    return tuple(
        RgbdFrame(
            color_bgr=no_color,
            depth_raw=no_depth,
            depth_factor=1000.0,
            **{name: field(k) for name, field in fields.items()},
        )
        for k in range(count)
    )


def make_capture(
    frames: Sequence[RgbdFrame] | None = None, error: str = "", **counters: int
) -> StreamSample:
    """Make the stream sample of a good camera, except for the arguments."""
    samples = make_samples() if frames is None else tuple(frames)
    return StreamSample(
        frames=samples,
        first_frame_s=1.2 if samples else None,
        counters=CameraCounters(delivered=len(samples), **counters),
        intrinsics_source="factory",
        error=error,
    )


def make_context(
    sensors: Iterable[UsbSensor] = (),
    stream: StreamSample | None = None,
    root: Path = Path("/nowhere"),
    source: str = "freenect",
) -> CheckContext:
    """Make a computer with these sensors; its files are under `root`."""
    all_sensors = tuple(sensors)
    return CheckContext(
        requested_camera(source), lambda: all_sensors, lambda: stream or make_capture(), root
    )


def make_usb_device(root: Path, path: str, busnum: int, devnum: int, **attributes: str) -> Path:
    """Make a device in a folder like /sys and return the device's folder.

    `path` starts at the controller, such as "0000:00:14.0/usb1/1-2".
    """
    folder = root / "sys/devices/pci0000:00" / path
    folder.mkdir(parents=True)
    attributes = {"idVendor": "0000", "idProduct": "0000", "bDeviceClass": "00"} | attributes
    for name, text in ({"busnum": str(busnum), "devnum": str(devnum)} | attributes).items():
        (folder / name).write_text(f"{text}\n")
    links = root / "sys/bus/usb/devices"
    links.mkdir(parents=True, exist_ok=True)
    (links / folder.name).symlink_to(folder)
    return folder


def make_usb_interface(device: Path, number: int, interface_class: str, driver: str = "") -> Path:
    """Make an interface of a device, with or without a kernel driver, and return its folder."""
    folder = device / f"{device.name}:1.{number}"
    folder.mkdir()
    (folder / "bInterfaceClass").write_text(f"{interface_class}\n")
    if driver:
        driver_folder = device / "drivers" / driver
        driver_folder.mkdir(parents=True, exist_ok=True)
        (folder / "driver").symlink_to(driver_folder)
    return folder
