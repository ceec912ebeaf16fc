"""Commands to the service, and the error for a command that is refused."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.camera import Led
from drivers.core.geometry import Array

# Pattern of the names of recordings and maps, which become file names.
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"


class ErrorCode(StrEnum):
    """Cause of a failed command, for programs; the message describes it for people."""

    BAD_REQUEST = "bad-request"  # the arguments are wrong; sending them again does not help
    UNKNOWN_COMMAND = "unknown-command"
    NOT_POSSIBLE = "not-possible"  # not with this camera or this configuration, or not now
    BUSY = "busy"  # too many commands are waiting
    RATE_LIMITED = "rate-limited"
    FAILED = "failed"
    TIMED_OUT = "timed-out"


class CommandError(Exception):
    """A command was refused or failed.

    Attributes:
        code: Cause, for programs.
    """

    def __init__(self, code: ErrorCode, message: str) -> None:
        """Make the error.

        Args:
            code: Cause, for programs.
            message: One clause, for people.
        """
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class ResetCommand:
    """Start a new epoch.

    Attributes:
        T_odom_base: 4x4 pose of the base at the start of the epoch; None: level, at the origin.
    """

    T_odom_base: Array | None = None


@dataclass(frozen=True)
class PauseCommand:
    """Stop publishing poses until `ResumeCommand`."""


@dataclass(frozen=True)
class ResumeCommand:
    """Publish poses again after `PauseCommand`."""


@dataclass(frozen=True)
class TiltCommand:
    """Tilt the sensor.

    Attributes:
        tilt_deg: Angle of the sensor's head above the horizon, degrees.
    """

    tilt_deg: float


@dataclass(frozen=True)
class LedCommand:
    """Switch the sensor's LED.

    Attributes:
        led: Color and blinking of the LED.
    """

    led: Led


@dataclass(frozen=True)
class StartRecordingCommand:
    """Start a recording.

    Attributes:
        name: Name of the recording's folder below the state folder.
    """

    name: str


@dataclass(frozen=True)
class StopRecordingCommand:
    """End the current recording."""


@dataclass(frozen=True)
class SaveIncidentCommand:
    """Write the frames of the flight recorder into a folder."""


@dataclass(frozen=True)
class SaveMapCommand:
    """Mesh the keyframes of this epoch and save the map.

    Attributes:
        name: Name of the map.
    """

    name: str


@dataclass(frozen=True)
class LoadMapCommand:
    """Replace the keyframe database by that of a saved map.

    Attributes:
        name: Name of the map.
    """

    name: str


@dataclass(frozen=True)
class ReloadConfig:
    """Apply a configuration that was read again. Only the program itself sends it.

    Attributes:
        apply: Applies the changes; called on the loop's thread.
    """

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
