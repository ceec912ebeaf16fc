"""What systemd is asked to do: on this computer, or (`root`) in a tree that will be one."""

from collections.abc import Callable
from pathlib import Path

from drivers.core.errors import UserFacingError
from vo_service.tools.install.run_command import run_command
from vo_service.tools.install.unit import ServiceUnit

# `systemctl enable --now` returns when the service is ready: the first time, kernels are compiled.
START_TIMEOUT_S = 1300.0
STOP_TIMEOUT_S = 60.0
# A pattern: a plain name of a unit that is not there would be an error.
UNIT_PATTERN = "kinect-vo*.service"
RUNTIME_FOLDER = Path("/run/systemd/system")  # sd_booted(3)
WANTS_FOLDER = Path("etc/systemd/system/multi-user.target.wants")


class Systemd:
    """The systemd that runs here. Everything raises UserFacingError where it fails."""

    def __init__(self) -> None:
        if not RUNTIME_FOLDER.is_dir():
            raise UserFacingError(
                "systemd does not run here, so there is nothing to install a service into; for an "
                "image of another system, give its tree with --root DIR"
            )

    def reload_and_restart(self) -> None:
        """Units have changed: read them, and let what runs begin anew with the new program."""
        _run_or_raise("systemctl", "daemon-reload")
        _run_or_raise("systemctl", "try-restart", UNIT_PATTERN, timeout_s=START_TIMEOUT_S)

    def enable(self, unit: ServiceUnit, print_line: Callable[[str], None]) -> None:
        """Start it now and at every start of the computer; returns when it is ready."""
        print_line(f"{unit.unit_name}: starting; the first time, kernels are compiled ...")
        complaint = run_command(
            "systemctl", "enable", "--now", unit.unit_name, timeout_s=START_TIMEOUT_S
        )
        if complaint:
            raise UserFacingError(f"{complaint}; see: journalctl -u {unit.unit_name} -n 20")
        print_line(f"{unit.unit_name}: enabled and running")

    def disable_all(self, root: Path) -> None:
        """Stop everything, now and for good."""
        _run_or_raise("systemctl", "stop", UNIT_PATTERN, timeout_s=STOP_TIMEOUT_S)
        for unit in list_enabled_units(root):
            _run_or_raise("systemctl", "disable", unit)

    def reload_after_removal(self) -> None:
        """Units have gone."""
        _run_or_raise("systemctl", "daemon-reload")
        run_command("systemctl", "reset-failed", UNIT_PATTERN)  # fails where nothing had failed


class OfflineSystemd:
    """A tree that no systemd runs in: only what is done by files."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def reload_and_restart(self) -> None:
        """Nothing runs."""

    def enable(self, unit: ServiceUnit, print_line: Callable[[str], None]) -> None:
        """Start it at every start of that computer."""
        _run_or_raise("systemctl", f"--root={self._root}", "enable", unit.unit_name)
        print_line(f"{unit.unit_name}: enabled")

    def disable_all(self, root: Path) -> None:
        """Start none of it any more."""
        for unit in list_enabled_units(root):
            _run_or_raise("systemctl", f"--root={root}", "disable", unit)

    def reload_after_removal(self) -> None:
        """Nothing runs."""


def list_enabled_units(root: Path) -> list[str]:
    """The units of ours that are started with the computer."""
    return sorted(link.name for link in (root / WANTS_FOLDER).glob(UNIT_PATTERN))


def _run_or_raise(*command: str, timeout_s: float = STOP_TIMEOUT_S) -> None:
    complaint = run_command(*command, timeout_s=timeout_s)
    if complaint:
        raise UserFacingError(f"{complaint}; see to that and run it again")
