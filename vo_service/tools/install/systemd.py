"""Units of the service, and control of systemd, on this computer or in a file system tree."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.core import InputError, UserFacingError
from vo_service.tools.install.program import SCRIPT_PATH
from vo_service.tools.install.system_files import SystemFile, run_command

SERVICE_FILES = Path(__file__).parents[2] / "service_files"
UNIT_FOLDER = Path("etc/systemd/system")
CONFIG_FOLDER = Path("etc/kinect-vo")
COMMAND_LINK = Path("usr/local/bin/kinect-vo")
UNITS = ("kinect-vo.service", "kinect-vo@.service", "kinect-vo-replay@.service")
DROP_IN = "network-tls.conf"
# `systemctl enable --now` returns when the service is ready. The first start compiles kernels.
START_TIMEOUT_S = 1300.0
STOP_TIMEOUT_S = 60.0
# As a pattern, this is no error if no unit matches.
UNIT_PATTERN = "kinect-vo*.service"
RUNTIME_FOLDER = Path("/run/systemd/system")  # sd_booted(3)
WANTS_FOLDER = Path("etc/systemd/system/multi-user.target.wants")


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
    """Link ``kinect-vo`` into the PATH; returns False if the name exists. Raises OSError."""
    link = root / COMMAND_LINK
    if os.path.lexists(link):
        return False
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(Path("/") / SCRIPT_PATH)
    return True


def unlink_command(root: Path) -> bool:
    """Remove the link; returns False if it is not ours. Raises OSError."""
    link = root / COMMAND_LINK
    if not link.is_symlink() or link.readlink() != Path("/") / SCRIPT_PATH:
        return False
    link.unlink()
    return True


class Systemd:
    """The systemd of this computer. All methods raise UserFacingError if systemctl fails."""

    def __init__(self) -> None:
        if not RUNTIME_FOLDER.is_dir():
            raise UserFacingError(
                "systemd does not run here; to install into the tree of another system, "
                "use --root DIR"
            )

    def reload_and_restart(self) -> None:
        """Reload changed units and restart running ones."""
        _run_or_raise("systemctl", "daemon-reload")
        _run_or_raise("systemctl", "try-restart", UNIT_PATTERN, timeout_s=START_TIMEOUT_S)

    def enable(self, unit: ServiceUnit, print_line: Callable[[str], None]) -> None:
        """Start a unit now and at every boot; returns when it is ready."""
        print_line(f"{unit.unit_name}: starting; the first time, kernels are compiled ...")
        error = run_command(
            "systemctl", "enable", "--now", unit.unit_name, timeout_s=START_TIMEOUT_S
        ).error
        if error:
            raise UserFacingError(f"{error}; see: journalctl -u {unit.unit_name} -n 20")
        print_line(f"{unit.unit_name}: enabled and running")

    def disable_all(self) -> None:
        """Stop and disable all units."""
        _run_or_raise("systemctl", "stop", UNIT_PATTERN, timeout_s=STOP_TIMEOUT_S)
        for unit in list_enabled_units(Path("/")):
            _run_or_raise("systemctl", "disable", unit)

    def reload_after_removal(self) -> None:
        """Reload after the units were removed."""
        _run_or_raise("systemctl", "daemon-reload")
        run_command("systemctl", "reset-failed", UNIT_PATTERN)  # fails if no unit has failed


class OfflineSystemd:
    """Offline tree without a running systemd: only files are changed."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def reload_and_restart(self) -> None:
        """Do nothing: no unit runs."""

    def enable(self, unit: ServiceUnit, print_line: Callable[[str], None]) -> None:
        """Start a unit at every boot."""
        _run_or_raise("systemctl", f"--root={self._root}", "enable", unit.unit_name)
        print_line(f"{unit.unit_name}: enabled")

    def disable_all(self) -> None:
        """Disable all units."""
        for unit in list_enabled_units(self._root):
            _run_or_raise("systemctl", f"--root={self._root}", "disable", unit)

    def reload_after_removal(self) -> None:
        """Do nothing: no unit runs."""


def list_enabled_units(root: Path) -> list[str]:
    """Return our units that start at boot."""
    return sorted(link.name for link in (root / WANTS_FOLDER).glob(UNIT_PATTERN))


def _run_or_raise(*command: str, timeout_s: float = STOP_TIMEOUT_S) -> None:
    error = run_command(*command, timeout_s=timeout_s).error
    if error:
        raise UserFacingError(f"{error}; fix this and re-run")
