"""What systemd is asked to do: on this computer, or (`root`) in a tree that will be one."""

from collections.abc import Callable
from pathlib import Path

from drivers.errors import UserFacingError
from vo_service.installation.calls import call
from vo_service.installation.unit import Unit

# `systemctl enable --now` returns when the service is ready: the first time, kernels are compiled.
START_LIMIT_S = 1300.0
STOP_LIMIT_S = 60.0
# A pattern: a plain name of a unit that is not there would be an error.
OURS = "kinect-vo*.service"
RUNNING = Path("/run/systemd/system")  # sd_booted(3)
WANTS = Path("etc/systemd/system/multi-user.target.wants")


class Systemd:
    """The systemd that runs here. Everything raises UserFacingError where it fails."""

    def __init__(self) -> None:
        if not RUNNING.is_dir():
            raise UserFacingError(
                "systemd does not run here, so there is nothing to install a service into; for an "
                "image of another system, give its tree with --root DIR"
            )

    def installed(self) -> None:
        """Units have changed: read them, and let what runs begin anew with the new program."""
        _demand("systemctl", "daemon-reload")
        _demand("systemctl", "try-restart", OURS, limit_s=START_LIMIT_S)

    def enable(self, unit: Unit, tell: Callable[[str], None]) -> None:
        """Start it now and at every start of the computer; returns when it is ready."""
        tell(f"{unit.unit}: starting; the first time, kernels are compiled ...")
        complaint = call("systemctl", "enable", "--now", unit.unit, timeout_s=START_LIMIT_S)
        if complaint:
            raise UserFacingError(f"{complaint}; see: journalctl -u {unit.unit} -n 20")
        tell(f"{unit.unit}: enabled and running")

    def disable_all(self, root: Path) -> None:
        """Stop everything, now and for good."""
        _demand("systemctl", "stop", OURS, limit_s=STOP_LIMIT_S)
        for unit in enabled_units(root):
            _demand("systemctl", "disable", unit)

    def removed(self) -> None:
        """Units have gone."""
        _demand("systemctl", "daemon-reload")
        call("systemctl", "reset-failed", OURS)  # fails where nothing had failed


class Offline:
    """A tree that no systemd runs in: only what is done by files."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def installed(self) -> None:
        """Nothing runs."""

    def enable(self, unit: Unit, tell: Callable[[str], None]) -> None:
        """Start it at every start of that computer."""
        _demand("systemctl", f"--root={self._root}", "enable", unit.unit)
        tell(f"{unit.unit}: enabled")

    def disable_all(self, root: Path) -> None:
        """Start none of it any more."""
        for unit in enabled_units(root):
            _demand("systemctl", f"--root={root}", "disable", unit)

    def removed(self) -> None:
        """Nothing runs."""


def enabled_units(root: Path) -> list[str]:
    """The units of ours that are started with the computer."""
    return sorted(link.name for link in (root / WANTS).glob(OURS))


def _demand(*command: str, limit_s: float = STOP_LIMIT_S) -> None:
    complaint = call(*command, timeout_s=limit_s)
    if complaint:
        raise UserFacingError(f"{complaint}; see to that and run it again")
