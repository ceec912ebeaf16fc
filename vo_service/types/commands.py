"""The commands that others send to the service, and why one is refused."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.camera import Led
from drivers.core.geometry import Array

# Names of recordings and maps, which become names of files.
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"


class ErrorCode(StrEnum):
    """What went wrong, for programs; the message says it to people."""

    BAD_REQUEST = "bad-request"  # the arguments are wrong; the same again will not help
    UNKNOWN_COMMAND = "unknown-command"
    NOT_POSSIBLE = "not-possible"  # not with this camera or this configuration, or not now
    BUSY = "busy"  # too many commands are waiting
    RATE_LIMITED = "rate-limited"
    FAILED = "failed"
    TIMED_OUT = "timed-out"


class CommandError(Exception):
    """A command that was refused or failed; the text is one clause that a person understands."""

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class ResetCommand:
    """Begin a new epoch with the base at `T_odom_base` (4x4); None: level, at the origin."""

    T_odom_base: Array | None = None


@dataclass(frozen=True)
class PauseCommand:
    """Publish no poses until `ResumeCommand`."""


@dataclass(frozen=True)
class ResumeCommand:
    """Go on after `PauseCommand`."""


@dataclass(frozen=True)
class TiltCommand:
    """Tilt the sensor's head against the horizon."""

    tilt_deg: float


@dataclass(frozen=True)
class LedCommand:
    """Switch the sensor's light."""

    led: Led


@dataclass(frozen=True)
class StartRecordingCommand:
    """Record frames into a folder of this name, below the state folder."""

    name: str


@dataclass(frozen=True)
class StopRecordingCommand:
    """End the recording."""


@dataclass(frozen=True)
class SaveIncidentCommand:
    """Write out what the flight recorder holds."""


@dataclass(frozen=True)
class SaveMapCommand:
    """Make a map of where the camera has been in this epoch, and write it under this name."""

    name: str


@dataclass(frozen=True)
class LoadMapCommand:
    """Forget the places that are known, and know those of the map of this name."""

    name: str


@dataclass(frozen=True)
class ReloadConfig:
    """Apply a configuration that was read again. Only the program itself sends it."""

    apply: Callable[[], None]


Command = (
    ResetCommand
    | PauseCommand
    | ResumeCommand
    | TiltCommand
    | LedCommand
    | StartRecordingCommand
    | StopRecordingCommand
    | SaveIncidentCommand
    | SaveMapCommand
    | LoadMapCommand
    | ReloadConfig
)
