"""The installed rules, checked by systemd's udevadm with a simulated camera."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from drivers.core import UserFacingError
from drivers.kinect_usb.usb_ids import SUPPORTED_IDS, UsbId
from tests.mount_namespace import AS_MAPPED_ROOT, need_mounts
from tests.simulators.requirements import require_program
from vo_service.tools.install import udev
from vo_service.tools.install.system_files import run_command
from vo_service.tools.install.udev import RULES_FILE, format_rules, install

# Run udevadm in its own tree: /sys has one camera. $1 is the folder with the rules files,
# $2 and $3 are the ids of the camera.
UDEVADM_SCRIPT = """
set -e
mount -t tmpfs none /sys; mount -t tmpfs none /run
device=/sys/devices/pci0000:00/usb1/1-1
mkdir -p $device /sys/bus/usb/devices /sys/dev/char /sys/class
ln -s ../../../bus/usb $device/subsystem
ln -s ../../devices/pci0000:00/usb1/1-1 /sys/dev/char/189:1
printf 'MAJOR=189\\nMINOR=1\\nDEVNAME=bus/usb/001/002\\nDEVTYPE=usb_device\\n' > $device/uevent
echo $2 > $device/idVendor; echo $3 > $device/idProduct
mkdir /run/udev /run/udev/rules.d; cp $1/* /run/udev/rules.d/
SYSTEMD_DEVICE_VERIFY_SYSFS=0 udevadm test --action=add $device 2>&1
"""
OPEN_TO_ALL = """\
SUBSYSTEM=="usb", ATTR{idVendor}=="045e", MODE:="0666", GROUP:="video"
SUBSYSTEM=="usb", ATTR{idVendor}=="1d27", MODE:="0666", GROUP:="video"
"""


def apply_rules(folder: Path, vendor: int, product: int) -> list[str]:
    """Return the modes that the rules set for a device, and `uaccess` if they tag it."""
    require_program("udevadm", "udev")
    need_mounts(AS_MAPPED_ROOT)
    arguments = [str(folder), f"{vendor:04x}", f"{product:04x}"]
    command = [*AS_MAPPED_ROOT, "sh", "-c", UDEVADM_SCRIPT, "sh", *arguments]
    process = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert process.returncode == 0, process.stdout + process.stderr
    return ["".join(groups) for groups in re.findall(r"MODE (\d+)|RUN '(uaccess)'", process.stdout)]


@pytest.mark.parametrize("line", SUPPORTED_IDS, ids=lambda line: line.text)
def test_every_sensor_has_its_rule(line: UsbId) -> None:
    vendor, _, product = line.text.partition(":")
    rule = f'ATTR{{idVendor}}=="{vendor}", '
    rule += "" if product == "*" else f'ATTR{{idProduct}}=="{product}", '
    assert f'{rule}MODE:="0660", GROUP:="plugdev", TAG+="uaccess"\n' in format_rules()


@pytest.mark.subprocess
@pytest.mark.parametrize(("vendor", "product"), [(0x045E, 0x02AE), (0x1D27, 0x0609)])
def test_our_rules_override_rules_that_open_the_camera_to_everybody(
    tmp_path: Path, vendor: int, product: int
) -> None:
    (tmp_path / "60-libopenni2-0.rules").write_text(OPEN_TO_ALL)
    (tmp_path / RULES_FILE.name).write_text(format_rules())
    modes = apply_rules(tmp_path, vendor, product)
    assert modes[-2:] == ["0660", "uaccess"]
    assert "0666" not in modes


@pytest.mark.subprocess
def test_without_our_rules_the_camera_is_open_to_everybody(tmp_path: Path) -> None:
    (tmp_path / "60-libopenni2-0.rules").write_text(OPEN_TO_ALL)
    assert apply_rules(tmp_path, 0x045E, 0x02AE)[-1] == "0666"


@pytest.mark.subprocess
def test_other_devices_do_not_match(tmp_path: Path) -> None:
    (tmp_path / RULES_FILE.name).write_text(format_rules())
    assert "0660" not in apply_rules(tmp_path, 0x046D, 0x0825)


def test_everybody_can_read_what_was_installed(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        install(tmp_path)
    finally:
        os.umask(before)
    assert (tmp_path / RULES_FILE).stat().st_mode & 0o777 == 0o644


def test_an_old_file_is_replaced(tmp_path: Path) -> None:
    install(tmp_path)
    (tmp_path / RULES_FILE).write_text("# an older version\n")
    assert install(tmp_path) == [tmp_path / RULES_FILE]
    assert (tmp_path / RULES_FILE).read_text() == format_rules()
    assert [path.name for path in (tmp_path / RULES_FILE).parent.iterdir()] == [RULES_FILE.name]


def test_the_error_names_the_command_for_root(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, text: str) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(udev, "write_file", refuse)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    command = f"only root may .*; run: sudo .*udev install --root {tmp_path}$"
    with pytest.raises(UserFacingError, match=command):
        install(tmp_path)


@pytest.mark.subprocess
def test_the_error_of_a_missing_or_failing_command_is_one_line() -> None:
    assert run_command("no-such-command-here").error == "no-such-command-here is not installed here"
    assert run_command("ls", "/nowhere").error.startswith("`ls /nowhere` failed: ls: ")
    assert run_command("sleep", "9", timeout_s=0.01).error.startswith("`sleep 9`: ")
    assert run_command("echo", "hello").output == "hello\n"


def test_a_tree_that_is_a_file_is_reported(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("")
    with pytest.raises(UserFacingError, match="Not a directory"):
        install(tmp_path)
