"""Data that the checks share. Each item is read once, when the first check needs it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from drivers.kinect_usb.usb_ids import SensorModel
from vo_service.tools.doctor.stream_probe import StreamSample
from vo_service.tools.doctor.sysfs import KernelUsbDevice, list_usb_devices
from vo_service.tools.doctor.usb_probe import UsbPart, UsbSensor


@dataclass(frozen=True)
class SystemPaths:
    """Paths of the kernel's virtual files; tests use another root than /."""

    root: Path = Path("/")

    @property
    def sys(self) -> Path:
        """Folder with the kernel's devices."""
        return self.root / "sys"

    @property
    def proc(self) -> Path:
        """Folder with the processes."""
        return self.root / "proc"


class CheckContext:
    """One computer and one requested camera."""

    def __init__(
        self,
        paths: SystemPaths,
        requested: "RequestedSensor",
        probe_usb: Callable[[], Sequence[UsbSensor]],
        probe_stream: Callable[[], StreamSample],
    ) -> None:
        """Store the sources of the data; nothing is read yet.

        Args:
            paths: Paths of the computer's virtual files.
            requested: The sensor to check.
            probe_usb: Finds the sensors on the USB.
            probe_stream: Opens the camera and reads its frames.
        """
        self.paths = paths
        self.requested = requested
        self._probe_usb = probe_usb
        self._probe_stream = probe_stream

    @cached_property
    def sensors(self) -> Sequence[UsbSensor]:
        """All sensors on the USB.

        Raises:
            UserFacingError: If they cannot be listed.
        """
        return self._probe_usb()

    @property
    def sensor(self) -> UsbSensor:
        """The requested sensor. Only for checks that need the check `sensor`, which finds it."""
        return next(sensor for sensor in self.sensors if self.requested.matches(sensor))

    @cached_property
    def stream(self) -> StreamSample:
        """Frames and errors of the camera.

        Raises:
            InputError: For invalid user input.
        """
        return self._probe_stream()

    @cached_property
    def kernel_devices(self) -> list[KernelUsbDevice]:
        """All USB devices that the kernel lists."""
        return list_usb_devices(self.paths.sys)

    def kernel_device(self, part: UsbPart) -> KernelUsbDevice | None:
        """Return the kernel's entry for a part of a sensor, or None if it has none."""
        bus_and_address = (str(part.bus), str(part.address))
        return next(
            (device for device in self.kernel_devices if device.bus_and_address == bus_and_address),
            None,
        )


@dataclass(frozen=True)
class RequestedSensor:
    """Requested sensor: one of these models, with this serial number unless it is ""."""

    models: frozenset[SensorModel]
    connect_fix: str
    serial: str = ""

    def matches(self, sensor: UsbSensor) -> bool:
        """Return True if a sensor may be the requested one. An unreadable serial number matches."""
        return sensor.model in self.models and (
            not self.serial or sensor.serial in ("", self.serial)
        )
