"""``kinect-vo udev``: install, show or remove the udev rules of the sensors."""

import argparse
from pathlib import Path

from vo_service.cli.options import print_message
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's actions."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action", required=True)
    for name, text in (
        ("install", "write the files and have udev read them (as root)"),
        ("uninstall", "remove the files and have udev forget them (as root)"),
    ):
        action = actions.add_parser(name, help=text)
        action.add_argument(
            "--root", metavar="DIR", type=Path, help="a tree other than /; nothing is reloaded"
        )
    actions.add_parser("show", help="print the files")


def run(args: argparse.Namespace) -> int:
    """Install, uninstall or show.

    Raises:
        UserFacingError: If it fails, or if the user may not: with the sudo command.
    """
    if args.action == "show":
        print("\n".join(f"# /{file.path}\n{file.text}" for file in list_system_files()), end="")
        return 0
    root: Path = args.root or Path("/")
    changed = (install if args.action == "install" else uninstall)(root)
    verb = "written" if args.action == "install" else "removed"
    for file in list_system_files():
        path = root / file.path
        rest = "was there already" if args.action == "install" else "was not there"
        print(f"{path}: {verb if path in changed else rest}")
    if args.root is None:
        _apply_rules()
    return 0


def _apply_rules() -> None:
    warning = apply_rules()
    if warning:
        print_message(f"kinect-vo: warning: {warning}; restart the computer to apply the change")
    else:
        print("Now unplug the sensor, with its power, and plug it in again.")
