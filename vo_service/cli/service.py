"""``kinect-vo service``: install the program as a systemd service, or uninstall it."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drivers.core import UserFacingError
from vo_service.cli.request import CommandRequest, Option, argument, flag, option
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


Root = Annotated[
    Path, Option("a tree other than /, such as an image's; nothing is started", metavar="DIR")
]


@dataclass(frozen=True, kw_only=True)
class InstallServiceRequest(CommandRequest):
    """Install or update the service (as root)."""

    name: str = option(
        "kinect-vo@NAME with /etc/kinect-vo/NAME.toml, one of several on this computer", "", "NAME"
    )
    enable: bool = flag("start the service now and at every boot")
    network_tls: bool = flag(
        "also install the drop-in that allows network access, for the TLS profile"
    )
    root: Root = Path("/")

    def apply(self, installer: Installer) -> None:
        unit = ServiceUnit(self.name)
        installer.install(unit, enable=self.enable, network_tls=self.network_tls)


@dataclass(frozen=True, kw_only=True)
class UninstallServiceRequest(CommandRequest):
    """Uninstall the service (as root)."""

    purge: bool = flag("also remove /etc/kinect-vo, incidents and compiled kernels")
    root: Root = Path("/")

    def apply(self, installer: Installer) -> None:
        installer.uninstall(purge=self.purge)


@dataclass(frozen=True, kw_only=True)
class ShowServiceFileRequest(CommandRequest):
    """Print an installed file."""

    file: str = argument("", allowed=[*UNITS, DROP_IN, "kinect.toml"])


ACTIONS = {
    "install": InstallServiceRequest,
    "uninstall": UninstallServiceRequest,
    "show": ShowServiceFileRequest,
}


def run(request: InstallServiceRequest | UninstallServiceRequest | ShowServiceFileRequest) -> int:
    """Install, uninstall or show."""
    if isinstance(request, ShowServiceFileRequest):
        print(read_service_file(request.file), end="")
        return 0
    root = request.root.absolute()
    before = os.umask(0o022)  # installed files are readable by every user
    try:
        _require_root(root, request)
        systemd = Systemd() if root == Path("/") else OfflineSystemd(root)
        request.apply(Installer(root, systemd, print_line))
    finally:
        os.umask(before)
    return 0


def print_line(text: str) -> None:
    """Print a line without buffering."""
    print(text, flush=True)


def _require_root(root: Path, request: InstallServiceRequest | UninstallServiceRequest) -> None:
    if root == Path("/") and os.geteuid() != 0:
        given = [f"--{key.replace('_', '-')}" for key, on in vars(request).items() if on is True]
        name = (
            ["--name", request.name]
            if isinstance(request, InstallServiceRequest) and request.name
            else []
        )
        action = next(name for name, kind in ACTIONS.items() if isinstance(request, kind))
        command = format_sudo_command("service", action, *name, *given)
        raise UserFacingError(f"only root may change the services of this computer; run: {command}")
