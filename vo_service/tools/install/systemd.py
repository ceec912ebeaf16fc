"""Control of systemd, on this computer or offline in a file system tree."""

from collections.abc import Callable
from pathlib import Path

from drivers.core.errors import UserFacingError
from vo_service.tools.install.run_command import run_command
from vo_service.tools.install.unit import ServiceUnit

# `systemctl enable --now` returns when the service is ready. The first start compiles kernels.
START_TIMEOUT_S = 1300.0
STOP_TIMEOUT_S = 60.0
# As a pattern, this is no error if no unit matches.
UNIT_PATTERN = "kinect-vo*.service"
RUNTIME_FOLDER = Path("/run/systemd/system")  # sd_booted(3)
WANTS_FOLDER = Path("etc/systemd/system/multi-user.target.wants")


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
        )
        if error:
            raise UserFacingError(f"{error}; see: journalctl -u {unit.unit_name} -n 20")
        print_line(f"{unit.unit_name}: enabled and running")

    def disable_all(self, root: Path) -> None:
        """Stop and disable all units."""
        _run_or_raise("systemctl", "stop", UNIT_PATTERN, timeout_s=STOP_TIMEOUT_S)
        for unit in list_enabled_units(root):
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

    def disable_all(self, root: Path) -> None:
        """Disable all units."""
        for unit in list_enabled_units(root):
            _run_or_raise("systemctl", f"--root={root}", "disable", unit)

    def reload_after_removal(self) -> None:
        """Do nothing: no unit runs."""


def list_enabled_units(root: Path) -> list[str]:
    """Return our units that start at boot."""
    return sorted(link.name for link in (root / WANTS_FOLDER).glob(UNIT_PATTERN))


def _run_or_raise(*command: str, timeout_s: float = STOP_TIMEOUT_S) -> None:
    error = run_command(*command, timeout_s=timeout_s)
    if error:
        raise UserFacingError(f"{error}; fix this and re-run")
