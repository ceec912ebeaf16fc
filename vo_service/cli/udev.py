"""``kinect-vo udev``: install, show or remove the udev rules of the sensors."""

from dataclasses import dataclass
from pathlib import Path

from vo_service.cli.options import print_message
from vo_service.cli.request import CommandRequest, option
from vo_service.tools.install.udev import apply_rules, install, list_system_files, uninstall

EPILOG = """\
examples:
  kinect-vo udev show                 prints the files
  sudo kinect-vo udev install         then unplug the sensor and plug it in again
  kinect-vo udev install --root DIR   into another tree, for a package; nothing is reloaded

Two files are written. /etc/udev/rules.d/59-kinect-vo.rules gives each sensor to the group plugdev
and to the user at the computer (mode 0660, uaccess). /etc/modprobe.d/kinect-vo.conf blocks the
kernel's webcam driver gspca_kinect. The command may be run again at any time.

The rules of Debian's libfreenect0.5 and libopenni2-0 let every user open some of these sensors
(mode 0666). Our rules are read first and are final, so they take precedence.
"""


@dataclass(frozen=True, kw_only=True)
class InstallRulesRequest(CommandRequest):
    """Write the files and have udev read them (as root)."""

    root: Path | None = option("a tree other than /; nothing is reloaded", metavar="DIR")


@dataclass(frozen=True, kw_only=True)
class UninstallRulesRequest(InstallRulesRequest):
    """Remove the files and have udev forget them (as root)."""


@dataclass(frozen=True, kw_only=True)
class ShowRulesRequest(CommandRequest):
    """Print the files."""


ACTIONS = {
    "install": InstallRulesRequest,
    "uninstall": UninstallRulesRequest,
    "show": ShowRulesRequest,
}


def run(request: InstallRulesRequest | ShowRulesRequest) -> int:
    """Install, uninstall or show."""
    if isinstance(request, ShowRulesRequest):
        print("\n".join(f"# /{file.path}\n{file.text}" for file in list_system_files()), end="")
        return 0
    root = request.root or Path("/")
    if isinstance(request, UninstallRulesRequest):
        changed, verb, rest = uninstall(root), "removed", "was not there"
    else:
        changed, verb, rest = install(root), "written", "was there already"
    for file in list_system_files():
        path = root / file.path
        print(f"{path}: {verb if path in changed else rest}")
    if request.root is not None:
        return 0
    if warning := apply_rules():
        print_message(f"kinect-vo: warning: {warning}; restart the computer to apply the change")
    else:
        print("Now unplug the sensor, with its power, and plug it in again.")
    return 0
