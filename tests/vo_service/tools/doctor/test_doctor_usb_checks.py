"""Checks of the sensor on the USB."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core import UserFacingError
from drivers.kinect_usb.usb_ids import SensorModel
from tests.vo_service.tools.doctor.doctor_fakes import (
    make_capture,
    make_context,
    make_sensor,
    make_usb_device,
    make_usb_interface,
)
from vo_service.tools.doctor.camera_checks import requested_camera
from vo_service.tools.doctor.check import CheckContext
from vo_service.tools.doctor.finding import CheckVerdict, Finding
from vo_service.tools.doctor.library_checks import check_firmware
from vo_service.tools.doctor.usb_checks import (
    check_controller,
    check_exclusive_access,
    check_kernel_driver,
    check_permission,
    check_presence,
    check_usb_speed,
)
from vo_service.tools.doctor.usb_probe import OpenError, UsbPart, UsbSensor
from vo_service.tools.install.udev import install

CONTROLLER = "0000:00:14.0"
CAMERA_FILE = "/dev/bus/usb/001/004"
FORBIDDEN = make_sensor(open_error=OpenError.PERMISSION, has_kernel_driver=None)
WITHOUT_FIRMWARE = make_sensor(SensorModel.K1473, audio_interfaces=1)


def test_the_sensor_is_named_with_its_model_place_and_serial() -> None:
    finding = check_presence(make_context([make_sensor(serial="A00364")]))
    assert finding.verdict is CheckVerdict.PASS
    assert finding.text == "Kinect 1414, bus 1 port 2.1, serial A00364"
    # A serial that cannot be read may be the requested one.
    requested = make_context([make_sensor()], source="freenect:A1")
    assert check_presence(requested).verdict is CheckVerdict.PASS


@pytest.mark.parametrize("model", [SensorModel.KINECT_V2, SensorModel.AZURE])
def test_a_later_kinect_is_named_as_unsupported(model: SensorModel) -> None:
    finding = check_presence(make_context([make_sensor(model)]))
    assert finding.verdict is CheckVerdict.FAIL
    assert finding.text.startswith(f"{model}, bus 1 port 2.1: unsupported model")


def test_a_usb_that_cannot_be_listed_is_reported() -> None:
    def raise_error() -> tuple[UsbSensor, ...]:
        raise UserFacingError("no answer within 15 s")

    context = CheckContext(requested_camera("freenect"), raise_error, make_capture)
    assert "no answer within 15 s" in check_presence(context).text


def test_the_kernel_gives_the_speed_if_libusb_does_not(tmp_path: Path) -> None:
    sensor = make_sensor(speed_mbit_s=None)
    unknown = make_context([sensor])
    assert check_usb_speed(unknown).verdict is CheckVerdict.UNKNOWN
    assert check_controller(unknown).verdict is CheckVerdict.UNKNOWN
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4, speed="480")
    finding = check_usb_speed(make_context([sensor], root=tmp_path))
    assert (finding.verdict, finding.text) == (CheckVerdict.PASS, "480 Mbit/s")


def test_the_sensors_own_parts_and_hubs_are_no_neighbors(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1", 1, 1, bDeviceClass="09")
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-3", 1, 5)
    finding = check_controller(make_context([make_sensor()], root=tmp_path))
    assert (finding.verdict, finding.text) == (
        CheckVerdict.PASS,
        "0000:00:14.0 serves the sensor alone",
    )


@pytest.mark.parametrize(
    ("place", "product", "interface_class", "verdict", "text"),
    [
        (f"{CONTROLLER}/usb1/1-4", "C270", "0e", CheckVerdict.WARNING, "also serves C270 0000:0"),
        (f"{CONTROLLER}/usb1/1-4", "Mouse", "03", CheckVerdict.PASS, "serves Mouse"),
        ("0000:00:1a.0/usb2/2-4", "C270", "0e", CheckVerdict.PASS, "serves the sensor alone"),
    ],
    ids=["webcam", "mouse", "elsewhere"],
)
def test_a_webcam_at_the_same_controller_is_a_warning(
    tmp_path: Path, place: str, product: str, interface_class: str, verdict: CheckVerdict, text: str
) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    neighbor = make_usb_device(tmp_path, place, 2, 9, product=product)
    make_usb_interface(neighbor, 0, interface_class)
    finding = check_controller(make_context([make_sensor()], root=tmp_path))
    assert finding.verdict is verdict
    assert text in finding.text


def test_a_second_sensor_at_the_same_controller_is_a_warning(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-3", 1, 7, product="Xbox NUI Camera")
    second = make_sensor(camera=UsbPart(1, 7), others=())
    finding = check_controller(make_context([make_sensor(others=()), second], root=tmp_path))
    assert finding.verdict is CheckVerdict.WARNING
    assert "Xbox NUI Camera" in finding.text


def make_process(root: Path, number: int, name: str, *open_files: str) -> None:
    """Make a process in a folder like /proc."""
    folder = root / "proc" / str(number)
    (folder / "fd").mkdir(parents=True)
    (folder / "comm").write_text(f"{name.partition(' ')[0]}\n")
    (folder / "cmdline").write_text(name.replace(" ", "\0"))
    for k, file in enumerate(open_files):
        (folder / "fd" / str(k)).symlink_to(file)


def test_the_fix_is_to_install_the_rules_then_to_replug_or_to_join_the_group(
    tmp_path: Path,
) -> None:
    context = make_context([FORBIDDEN], root=tmp_path)
    finding = check_permission(context)
    assert finding.verdict is CheckVerdict.FAIL
    assert "are not installed" in finding.text
    assert finding.fix.startswith("sudo ")
    assert finding.fix.endswith("udev install, then unplug the sensor and plug it in again")
    install(tmp_path)
    finding = check_permission(context)
    assert "are installed" in finding.text
    assert finding.fix.startswith("unplug the sensor and plug it in again")
    assert "usermod -aG plugdev" in finding.fix


def test_the_kernels_webcam_driver_is_named(tmp_path: Path) -> None:
    sensor = make_sensor(has_kernel_driver=True)
    assert check_kernel_driver(make_context([sensor])).text == "a kernel driver has the camera"
    device = make_usb_device(tmp_path, "0000:00:14.0/usb1/1-2", 1, 4)
    camera = make_usb_interface(device, 0, "ff", driver="gspca_kinect")
    (camera / "video4linux/video2").mkdir(parents=True)
    finding = check_kernel_driver(make_context([sensor], root=tmp_path))
    assert finding.verdict is CheckVerdict.WARNING
    assert finding.text == "gspca_kinect has the camera as /dev/video2"
    assert "udev install, which keeps gspca_kinect away" in finding.fix


def test_a_program_that_has_claimed_the_camera_is_no_kernel_driver(tmp_path: Path) -> None:
    device = make_usb_device(tmp_path, "0000:00:14.0/usb1/1-2", 1, 4)
    make_usb_interface(device, 0, "ff", driver="usbfs")
    finding = check_kernel_driver(make_context([make_sensor()], root=tmp_path))
    assert finding.verdict is CheckVerdict.PASS


@pytest.mark.parametrize(
    ("number", "name", "text"),
    [
        (812, "freenect-glview", "freenect-glview (process 812) has the camera"),
        (
            813,
            "python -m drivers.core.process.worker_main "
            "drivers.subprocess_camera.worker:run_camera 7",
            "a running kinect-vo (process 813) has the camera",
        ),
    ],
    ids=["another", "ours"],
)
def test_the_program_that_has_the_camera_is_named(
    tmp_path: Path, number: int, name: str, text: str
) -> None:
    make_process(tmp_path, number, name, "/dev/null", CAMERA_FILE)
    make_process(tmp_path, 900, "bash", "/dev/null")
    busy = make_context([make_sensor(open_error=OpenError.BUSY)], root=tmp_path)
    finding = check_exclusive_access(busy)
    assert (finding.verdict, finding.text) == (CheckVerdict.FAIL, text)


def test_this_very_process_does_not_count(tmp_path: Path) -> None:
    make_process(tmp_path, os.getpid(), "kinect-vo", CAMERA_FILE)
    finding = check_exclusive_access(make_context([make_sensor()], root=tmp_path))
    assert finding.verdict is CheckVerdict.PASS


def test_a_program_that_uses_the_webcam_device_is_named(tmp_path: Path) -> None:
    device = make_usb_device(tmp_path, "0000:00:14.0/usb1/1-2", 1, 4)
    (make_usb_interface(device, 0, "ff", "gspca_kinect") / "video4linux/video2").mkdir(parents=True)
    make_process(tmp_path, 77, "cheese", "/dev/video2")
    finding = check_exclusive_access(
        make_context([make_sensor(has_kernel_driver=True)], root=tmp_path)
    )
    assert finding.text == "cheese (process 77) has the camera"


def test_another_open_error_is_reported() -> None:
    sensor = make_sensor(open_error=OpenError.OTHER, open_error_text="Input/Output Error")
    finding = check_exclusive_access(make_context([sensor]))
    assert (finding.verdict, finding.text) == (
        CheckVerdict.FAIL,
        "the camera cannot be opened: Input/Output Error",
    )


def test_only_a_later_kinect_needs_its_firmware_loaded() -> None:
    assert check_firmware(make_context([make_sensor()])).verdict is CheckVerdict.PASS
    loaded = make_sensor(SensorModel.K1473, audio_interfaces=2)
    assert check_firmware(make_context([loaded])).text == "loaded"


def test_missing_firmware_names_the_searched_folders_and_what_works(tmp_path: Path) -> None:
    context = make_context([WITHOUT_FIRMWARE])
    finding = check_firmware(context, (tmp_path,))
    assert finding.verdict is CheckVerdict.WARNING
    assert f"no audios.bin in {tmp_path}" in finding.text
    assert finding.text.endswith("tilt, light and accelerometer do not work, images do")
    (tmp_path / "audios.bin").write_bytes(b"")
    finding = check_firmware(context, (tmp_path,))
    assert finding.text.startswith(f"not loaded, although {tmp_path / 'audios.bin'} exists")


@pytest.mark.parametrize("check", [check_permission, check_kernel_driver, check_exclusive_access])
def test_a_computer_without_kernel_files_passes(check: Callable[[CheckContext], Finding]) -> None:
    assert check(make_context([make_sensor()])).verdict is CheckVerdict.PASS
