"""The state of kinect-vo as tasks of ROS's diagnostics, from the status over Zenoh."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

# The service sends a status twice a second.
STATUS_TIMEOUT_S = 2.0

JsonObject = Mapping[str, Any]


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Task:
    """One part of the service that can be faulty.

    Attributes:
        name: Name, without that of the node.
        message: What is wrong, or the state.
        values: The part's figures by name, as text.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str]


_TRACKING_LEVELS = {
    "tracking": Level.OK,
    "degraded": Level.WARN,
    "lost": Level.ERROR,
    "no_camera": Level.ERROR,
}
_CAMERA_LEVELS = {
    "streaming": Level.OK,
    "opening": Level.WARN,
    "starting": Level.WARN,
    "absent": Level.ERROR,
    "lost": Level.ERROR,
}


class Diagnostics:
    """Makes the tasks of each status; counts what changed since the last time."""

    def __init__(self) -> None:
        self._dropped: int | None = None

    def tasks(self, status: JsonObject) -> Sequence[Task]:
        """Make the tasks of a status that has just come."""
        return [
            _tracking(status),
            _camera(status["camera"]),
            self._timing(status),
            _service(status),
        ]

    def _timing(self, status: JsonObject) -> Task:
        total = int(status["camera"].get("dropped", 0))
        dropped = 0 if self._dropped is None else max(total - self._dropped, 0)
        self._dropped = total
        values = _as_text(status["latency"], "") | {"dropped": str(total)}
        if dropped:
            return Task("timing", Level.WARN, f"{dropped} frames dropped", values)
        return Task("timing", Level.OK, "no frame dropped", values)


def no_status(age_s: float | None) -> Task:
    """Make the task of a service that sends no status.

    Args:
        age_s: Age of the last status, s; None if there was none.
    """
    since = "since the start of this node" if age_s is None else f"for {age_s:.0f} s"
    message = f"no status {since}: kinect-vo has ended or cannot be reached"
    return Task("service", Level.ERROR, message, {})


def _tracking(status: JsonObject) -> Task:
    state, reason = str(status["state"]), str(status["reason"])
    level = _TRACKING_LEVELS.get(state, Level.WARN)
    message = f"{state}: {reason}" if reason else state
    if status["paused"]:
        level, message = max(level, Level.WARN), f"paused; {message}"
    values = {"epoch": str(status["epoch"])}
    for group in ("tracking", "level", "map"):
        values |= _as_text(status.get(group, {}), f"{group}.")
    return Task("tracking", level, message, values)


def _camera(camera: JsonObject) -> Task:
    state = str(camera["state"])
    return Task("camera", _CAMERA_LEVELS.get(state, Level.WARN), state, _as_text(camera, ""))


def _service(status: JsonObject) -> Task:
    warnings = "; ".join(status["warnings"])
    values = _as_text(status.get("versions", {}), "version.")
    values |= _as_text(status.get("recorder", {}), "recorder.")
    return Task("service", Level.WARN if warnings else Level.OK, warnings or "running", values)


def _as_text(content: JsonObject, prefix: str) -> dict[str, str]:
    """Flatten a group of the status."""
    values: dict[str, str] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            values |= _as_text(value, f"{prefix}{name}.")
        else:
            values[prefix + name] = f"{value:g}" if isinstance(value, float) else str(value)
    return values
