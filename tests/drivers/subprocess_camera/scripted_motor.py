"""A scripted camera with a head and a light."""

from pathlib import Path

from drivers.camera import Led
from drivers.core import CameraError
from tests.drivers.subprocess_camera.scripted_cameras import FileScriptedCamera

STUCK_DEG = -31.0


class MotorizedCamera(FileScriptedCamera):
    """Has a head and a light; a file beside the script tells what they do, a line each."""

    def __init__(self, script: Path) -> None:
        super().__init__(script)
        self._commands: dict[str, str] = {}
        self._is_open = False

    @property
    def has_motor(self) -> bool:
        return True

    def open(self) -> None:
        super().open()
        self._is_open = True
        for order in self._commands.values():
            self._record(order)

    def close(self) -> None:
        super().close()
        self._is_open = False

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Say so; a head that is told to look at its own feet is stuck."""
        if tilt_deg == STUCK_DEG:
            raise CameraError("the scripted camera's neck is stuck")
        self._set("tilt", f"tilt {tilt_deg:g}")

    def set_led(self, led: Led) -> None:
        self._set("light", f"light {led}")

    def _set(self, kind: str, order: str) -> None:
        self._commands[kind] = order
        if not self._is_open:
            raise CameraError("the scripted camera is in its box")
        self._record(order)

    def _record(self, order: str) -> None:
        with action_log(self._script).open("a") as file:
            file.write(f"{order}\n")


def action_log(script: Path) -> Path:
    """Where a scripted motor writes what it does."""
    return script.with_name("done")
