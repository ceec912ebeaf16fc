"""The systemd units, the default configuration and the link to the command."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import InputError
from vo_service.tools.install.program import SCRIPT_PATH
from vo_service.tools.install.system_files import SystemFile

SERVICE_FILES = Path(__file__).parents[2] / "service_files"
UNIT_FOLDER = Path("etc/systemd/system")
CONFIG_FOLDER = Path("etc/kinect-vo")
COMMAND_LINK = Path("usr/local/bin/kinect-vo")
UNITS = ("kinect-vo.service", "kinect-vo@.service", "kinect-vo-replay@.service")
DROP_IN = "network-tls.conf"


@dataclass(frozen=True)
class ServiceUnit:
    """Service of this computer: ``kinect-vo``, or ``kinect-vo@NAME`` with its own Zenoh keys.

    Raises:
        InputError: The name is not a single word.
    """

    name: str = ""

    def __post_init__(self) -> None:
        if self.name and not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", self.name):
            raise InputError(
                f"--name {self.name!r}: use letters, digits, '_', '-' or '.', such as front"
            )

    @property
    def unit_name(self) -> str:
        """Name for systemd."""
        return f"kinect-vo@{self.name}.service" if self.name else "kinect-vo.service"

    @property
    def config(self) -> Path:
        """Path of its configuration, relative to the root."""
        return CONFIG_FOLDER / f"{self.name or 'kinect'}.toml"

    @property
    def drop_in(self) -> Path:
        """Path of the drop-in that opens the network, relative to the root."""
        return UNIT_FOLDER / f"{self.unit_name}.d" / DROP_IN


def list_unit_files() -> tuple[SystemFile, ...]:
    """Return the unit files."""
    return tuple(SystemFile(UNIT_FOLDER / name, read_service_file(name)) for name in UNITS)


def read_service_file(name: str) -> str:
    """Return the text of a file that comes with the program."""
    return (SERVICE_FILES / name).read_text(encoding="utf-8")


def link_command(root: Path) -> bool:
    """Link ``kinect-vo`` into the PATH; returns False if the name exists.

    Raises:
        OSError: If that fails.
    """
    link = root / COMMAND_LINK
    if os.path.lexists(link):
        return False
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(Path("/") / SCRIPT_PATH)
    return True


def unlink_command(root: Path) -> bool:
    """Remove the link; returns False if it is not ours.

    Raises:
        OSError: If that fails.
    """
    link = root / COMMAND_LINK
    if not link.is_symlink() or link.readlink() != Path("/") / SCRIPT_PATH:
        return False
    link.unlink()
    return True
