"""The checks of permissions, kernel drivers, other programs and firmware."""

import os
from pathlib import Path

import pytest

from drivers.kinect_usb.usb_ids import SensorModel
from tests.vo_service.tools.doctor.doctor_fakes import (
    make_context,
    make_sensor,
    make_usb_device,
    make_usb_interface,
)
from vo_service.tools.doctor.access import ExclusiveAccessCheck, KernelDriverCheck, PermissionCheck
from vo_service.tools.doctor.finding import CheckVerdict
from vo_service.tools.doctor.firmware import FirmwareCheck
from vo_service.tools.doctor.usb_probe import OpenError
from vo_service.tools.install.udev import install

CAMERA_FILE = "/dev/bus/usb/001/004"
FORBIDDEN = make_sensor(open_error=OpenError.PERMISSION, has_kernel_driver=None)
WITHOUT_FIRMWARE = make_sensor(SensorModel.K1473, audio_interfaces=1)


def make_process(root: Path, number: int, name: str, *open_files: str) -> None:
    """Make a process in a folder like /proc."""
    folder = root / "proc" / str(number)
    (folder / "fd").mkdir(parents=True)
    (folder / "comm").write_text(f"{name.partition(' ')[0]}\n")
    (folder / "cmdline").write_text(name.replace(" ", "\0"))
    for k, file in enumerate(open_files):
        (folder / "fd" / str(k)).symlink_to(file)


def test_without_the_rules_the_fix_is_to_install_them_and_replug(tmp_path: Path) -> None:
    finding = PermissionCheck().run(make_context([FORBIDDEN], root=tmp_path))
    assert finding.verdict is CheckVerdict.FAIL
    assert "are not installed" in finding.text
    assert finding.fix.startswith("sudo ")
    assert finding.fix.endswith("udev install, then unplug the sensor and plug it in again")


def test_with_the_rules_the_fix_is_to_replug_or_to_join_the_group(tmp_path: Path) -> None:
    install(tmp_path)
    finding = PermissionCheck().run(make_context([FORBIDDEN], root=tmp_path))
    assert "are installed" in finding.text
    assert finding.fix.startswith("unplug the sensor and plug it in again")
    assert "usermod -aG plugdev" in finding.fix


def test_a_camera_that_may_be_opened_passes(tmp_path: Path) -> None:
    assert (
        PermissionCheck().run(make_context([make_sensor()], root=tmp_path)).verdict
        is CheckVerdict.PASS
    )


def test_the_kernels_webcam_driver_is_named(tmp_path: Path) -> None:
    device = make_usb_device(tmp_path, "0000:00:14.0/usb1/1-2", 1, 4)
    camera = make_usb_interface(device, 0, "ff", driver="gspca_kinect")
    (camera / "video4linux/video2").mkdir(parents=True)
    finding = KernelDriverCheck().run(
        make_context([make_sensor(has_kernel_driver=True)], root=tmp_path)
    )
    assert finding.verdict is CheckVerdict.WARNING
    assert finding.text == "gspca_kinect has the camera as /dev/video2"
    assert "udev install, which keeps gspca_kinect away" in finding.fix


def test_a_kernel_driver_is_seen_without_the_kernels_help() -> None:
    finding = KernelDriverCheck().run(make_context([make_sensor(has_kernel_driver=True)]))
    assert finding.text == "a kernel driver has the camera"


def test_a_program_that_has_claimed_the_camera_is_no_kernel_driver(tmp_path: Path) -> None:
    device = make_usb_device(tmp_path, "0000:00:14.0/usb1/1-2", 1, 4)
    make_usb_interface(device, 0, "ff", driver="usbfs")
    assert (
        KernelDriverCheck().run(make_context([make_sensor()], root=tmp_path)).verdict
        is CheckVerdict.PASS
    )


def test_the_program_that_has_the_camera_is_named(tmp_path: Path) -> None:
    make_process(tmp_path, 812, "freenect-glview", "/dev/null", CAMERA_FILE)
    make_process(tmp_path, 900, "bash", "/dev/null")
    finding = ExclusiveAccessCheck().run(
        make_context([make_sensor(open_error=OpenError.BUSY)], root=tmp_path)
    )
    assert finding.verdict is CheckVerdict.FAIL
    assert finding.text == "freenect-glview (process 812) has the camera"


def test_a_program_that_uses_the_webcam_device_is_named(tmp_path: Path) -> None:
    device = make_usb_device(tmp_path, "0000:00:14.0/usb1/1-2", 1, 4)
    (make_usb_interface(device, 0, "ff", "gspca_kinect") / "video4linux/video2").mkdir(parents=True)
    make_process(tmp_path, 77, "cheese", "/dev/video2")
    finding = ExclusiveAccessCheck().run(
        make_context([make_sensor(has_kernel_driver=True)], root=tmp_path)
    )
    assert finding.text == "cheese (process 77) has the camera"


def test_a_program_that_only_root_may_see_is_another(tmp_path: Path) -> None:
    finding = ExclusiveAccessCheck().run(
        make_context([make_sensor(open_error=OpenError.BUSY)], root=tmp_path)
    )
    assert finding.verdict is CheckVerdict.FAIL
    assert finding.text == "another program has the camera"


def test_our_own_driver_is_named(tmp_path: Path) -> None:
    make_process(tmp_path, 813, "python -m drivers.subprocess_camera.worker_main 7", CAMERA_FILE)
    finding = ExclusiveAccessCheck().run(
        make_context([make_sensor(open_error=OpenError.BUSY)], root=tmp_path)
    )
    assert finding.text == "a running kinect-vo (process 813) has the camera"


def test_this_very_process_does_not_count(tmp_path: Path) -> None:
    make_process(tmp_path, os.getpid(), "kinect-vo", CAMERA_FILE)
    assert (
        ExclusiveAccessCheck().run(make_context([make_sensor()], root=tmp_path)).verdict
        is CheckVerdict.PASS
    )


def test_another_open_error_is_reported() -> None:
    sensor = make_sensor(open_error=OpenError.OTHER, open_error_text="Input/Output Error")
    finding = ExclusiveAccessCheck().run(make_context([sensor]))
    assert (finding.verdict, finding.text) == (
        CheckVerdict.FAIL,
        "the camera cannot be opened: Input/Output Error",
    )


def test_the_1414_needs_no_firmware() -> None:
    assert FirmwareCheck().run(make_context([make_sensor()])).verdict is CheckVerdict.PASS


def test_loaded_firmware_passes() -> None:
    loaded = make_sensor(SensorModel.K1473, audio_interfaces=2)
    assert FirmwareCheck().run(make_context([loaded])).text == "loaded"


def test_missing_firmware_names_the_searched_folders_and_what_works(tmp_path: Path) -> None:
    finding = FirmwareCheck((tmp_path,)).run(make_context([WITHOUT_FIRMWARE]))
    assert finding.verdict is CheckVerdict.WARNING
    assert f"no audios.bin in {tmp_path}" in finding.text
    assert finding.text.endswith("tilt, light and accelerometer do not work, images do")


def test_firmware_that_exists_but_is_not_loaded_is_reported(tmp_path: Path) -> None:
    (tmp_path / "audios.bin").write_bytes(b"")
    finding = FirmwareCheck((tmp_path,)).run(make_context([WITHOUT_FIRMWARE]))
    assert finding.text.startswith(f"not loaded, although {tmp_path / 'audios.bin'} exists")


@pytest.mark.parametrize("check", [PermissionCheck(), KernelDriverCheck(), ExclusiveAccessCheck()])
def test_a_computer_without_kernel_files_passes(
    check: PermissionCheck | KernelDriverCheck | ExclusiveAccessCheck,
) -> None:
    assert check.run(make_context([make_sensor()])).verdict is CheckVerdict.PASS
