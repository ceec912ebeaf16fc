"""``kinect-vo service``: install the program as a systemd service, or uninstall it."""

import argparse
import os
from pathlib import Path

from drivers.core import UserFacingError
from vo_service.tools.install.installer import Installer
from vo_service.tools.install.system_files import format_sudo_command
from vo_service.tools.install.systemd import (
    DROP_IN,
    UNITS,
    OfflineSystemd,
    ServiceUnit,
    Systemd,
    read_service_file,
)

EPILOG = """\
examples:
  kinect-vo service show kinect-vo.service                print a file
  sudo .venv/bin/kinect-vo service install --enable       also start it, now and at boot
  sudo .venv/bin/kinect-vo service install --name front   kinect-vo@front, with keys front/...
  sudo kinect-vo service uninstall                        keeps the configuration and incidents
  sudo kinect-vo service uninstall --purge                removes them too

`install` copies this program with its dependencies to /opt/kinect-vo, because a service cannot read
/root or /home. It downloads nothing. It writes the units, the udev rules, the command
/usr/local/bin/kinect-vo and, if missing, /etc/kinect-vo/kinect.toml. Run again from a newer
checkout, it updates and restarts the service.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's actions."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action", required=True)
    install = actions.add_parser("install", help="install or update the service (as root)")
    install.add_argument(
        "--name", default="", metavar="NAME",
        help="kinect-vo@NAME with /etc/kinect-vo/NAME.toml, one of several on this computer",
    )  # fmt: skip
    install.add_argument(
        "--enable", action="store_true", help="start the service now and at every boot"
    )
    install.add_argument(
        "--network-tls", action="store_true",
        help="also install the drop-in that allows network access, for the TLS profile",
    )  # fmt: skip
    uninstall = actions.add_parser("uninstall", help="uninstall the service (as root)")
    uninstall.add_argument(
        "--purge", action="store_true",
        help="also remove /etc/kinect-vo, incidents and compiled kernels",
    )  # fmt: skip
    for action in (install, uninstall):
        action.add_argument(
            "--root", metavar="DIR", type=Path, default=Path("/"),
            help="a tree other than /, such as an image's; nothing is started",
        )  # fmt: skip
    show = actions.add_parser("show", help="print an installed file")
    show.add_argument("file", choices=[*UNITS, DROP_IN, "kinect.toml"])


def run(args: argparse.Namespace) -> int:
    """Install, uninstall or show.

    Raises:
        UserFacingError: If it fails, or if the user is not root: with the sudo command.
    """
    if args.action == "show":
        print(read_service_file(args.file), end="")
        return 0
    root: Path = args.root.absolute()
    before = os.umask(0o022)  # installed files are readable by every user
    try:
        _require_root(root, args)
        systemd = Systemd() if root == Path("/") else OfflineSystemd(root)
        installer = Installer(root, systemd, print_line)
        if args.action == "install":
            unit = ServiceUnit(args.name)
            installer.install(unit, enable=args.enable, network_tls=args.network_tls)
        else:
            installer.uninstall(purge=args.purge)
    finally:
        os.umask(before)
    return 0


def print_line(text: str) -> None:
    """Print a line without buffering."""
    print(text, flush=True)


def _require_root(root: Path, args: argparse.Namespace) -> None:
    if root == Path("/") and os.geteuid() != 0:
        given = [f"--{key.replace('_', '-')}" for key, value in vars(args).items() if value is True]
        name = ["--name", args.name] if getattr(args, "name", "") else []
        command = format_sudo_command("service", args.action, *name, *given)
        raise UserFacingError(f"only root may change the services of this computer; run: {command}")
