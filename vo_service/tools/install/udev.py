"""System files that let users open a sensor without root, from the table of USB ids."""

import os
from collections.abc import Callable
from pathlib import Path

from drivers.core import UserFacingError
from drivers.kinect_usb.usb_ids import SUPPORTED_IDS, UsbId
from vo_service.tools.install.system_files import (
    SystemFile,
    format_sudo_command,
    remove_file,
    run_command,
    write_file,
)

GROUP = "plugdev"
KERNEL_DRIVER = "gspca_kinect"  # webcam driver, which would hold the Kinect's camera
# Debian's 60-libopenni2-0.rules opens some of these ids to everybody with ":=", which later files
# cannot change. Only an earlier file with ":=" can restrict them.
RULES_FILE = Path("etc/udev/rules.d/59-kinect-vo.rules")
MODPROBE_FILE = Path("etc/modprobe.d/kinect-vo.conf")

_RULES_HEADING = f"""\
# The user at the computer (uaccess) and the group {GROUP} may use depth cameras.
# Written by: kinect-vo udev install    Removed by: kinect-vo udev uninstall
# The number 59 and the assignments with ":=" are needed because 60-libopenni2-0.rules sets
# MODE:="0666" for some of these devices, and the first ":=" wins.
# The Kinect 1473 has ids of the 1414 and of the Kinect for Windows.
ACTION=="remove", GOTO="kinect_vo_end"
SUBSYSTEM!="usb", GOTO="kinect_vo_end"
ENV{{DEVTYPE}}!="usb_device", GOTO="kinect_vo_end"
"""
_MODPROBE_TEXT = f"""\
# The kernel's webcam driver would hold the Kinect's camera.
# Written by: kinect-vo udev install    Removed by: kinect-vo udev uninstall
blacklist {KERNEL_DRIVER}
"""


def list_system_files() -> tuple[SystemFile, ...]:
    """The udev rules and the modprobe blacklist."""
    return (SystemFile(RULES_FILE, format_rules()), SystemFile(MODPROBE_FILE, _MODPROBE_TEXT))


def format_rules() -> str:
    """Return the udev rules: one per USB id of each supported sensor."""
    rules = "".join(_format_rule(line) for line in SUPPORTED_IDS)
    return f'{_RULES_HEADING}{rules}LABEL="kinect_vo_end"\n'


def _format_rule(line: UsbId) -> str:
    product = "" if line.product is None else f'ATTR{{idProduct}}=="{line.product:04x}", '
    return (
        f"# {line.model}: {line.role}\n"
        f'ATTR{{idVendor}}=="{line.vendor:04x}", {product}'
        f'MODE:="0660", GROUP:="{GROUP}", TAG+="uaccess"\n'
    )


def install(root: Path) -> list[Path]:
    """Write the files that differ and return their paths.

    Raises:
        UserFacingError: A file cannot be written. It names the command for root if needed.
    """
    return _change_files(root, "install", write_file)


def uninstall(root: Path) -> list[Path]:
    """Remove the files and return the paths of those that existed. Raises as `install`."""
    return _change_files(root, "uninstall", lambda path, text: remove_file(path))


def _change_files(root: Path, action: str, change: Callable[[Path, str], bool]) -> list[Path]:
    """Call `change` with each path and its text; return the paths for which it returns True."""
    changed = []
    for file in list_system_files():
        path = root / file.path
        try:
            if change(path, file.text):
                changed.append(path)
        except OSError as error:
            advice = f"{error.strerror}; fix this and re-run"
            if isinstance(error, PermissionError) and os.geteuid() != 0:
                tree = [] if root == Path("/") else ["--root", str(root)]
                command = format_sudo_command("udev", action, *tree)
                advice = f"only root may change this; run: {command}"
            raise UserFacingError(f"{path}: {advice}") from error
    return changed


def apply_rules() -> str:
    """Reload udev's rules and unload the webcam driver; returns the errors, or ""."""
    errors = [run_command("udevadm", "control", "--reload").error]
    if _is_loaded(KERNEL_DRIVER):
        errors.append(run_command("modprobe", "--remove", KERNEL_DRIVER).error)
    return "; ".join(error for error in errors if error)


def _is_loaded(module: str) -> bool:
    try:
        return any(line.split()[0] == module for line in Path("/proc/modules").open())
    except OSError:
        return False
