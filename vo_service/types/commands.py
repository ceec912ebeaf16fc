"""The commands to the service: names, arguments, replies, and the parser.

Each command is one class: its docstring, name and fields are the Zenoh key, the JSON Schemas, the
check of the arguments, the help of ``kinect-vo command`` and the table in
docs/reference/messages.md.
`vo_service.control` executes it.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Generic, TypeVar, get_args

import numpy as np

from drivers.camera import Led
from drivers.core import InputError
from drivers.core.config import (
    FILE_NAME_IN_WORDS,
    FILE_NAME_PATTERN,
    Field,
    FieldError,
    build_dataclass,
)
from drivers.core.geometry import Array, is_rigid, quaternion_from_rotation, transform_from_pose

MAX_PAYLOAD_BYTES = 4096
# Limit of a coordinate in `reset`, m.
MAX_POSITION_M = 1e6
MAX_TILT_DEG = 31.0
# A quaternion this far from length 1 is a mistake, not rounding.
QUATERNION_NORM_TOLERANCE = 1e-2
# A rotation in 32-bit floats may be this far from orthonormal.
RIGID_TOLERANCE = 1e-3

Reply = TypeVar("Reply")
Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Tilt = Annotated[
    float, Field("degrees above the horizon", minimum=-MAX_TILT_DEG, maximum=MAX_TILT_DEG)
]
LedState = Annotated[Led, "the sensor's LED"]
Name = Annotated[
    str,
    Field(
        "name of the folder or of the map",
        pattern=FILE_NAME_PATTERN,
        pattern_name=FILE_NAME_IN_WORDS,
    ),
]


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


class NotPossibleError(CommandError):
    """A command that cannot be done with this camera or this configuration, or not now."""

    def __init__(self, reason: str) -> None:
        super().__init__(ErrorCode.NOT_POSSIBLE, reason)


class TypedCommand(Generic[Reply]):
    """Base of the commands: frozen dataclasses whose fields are the arguments.

    Attributes:
        command_name: Last part of the Zenoh key.
        required_together: Arguments of which all or none are given.
    """

    command_name: ClassVar[str]
    required_together: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        given = [name for name in self.required_together if getattr(self, name) is not None]
        if given and len(given) < len(self.required_together):
            raise InputError(f"give {' and '.join(self.required_together)}, or none of them")

    @classmethod
    def reply_type(cls) -> type[Reply]:
        """Return the dataclass of the reply."""
        base: Any = vars(cls)["__orig_bases__"][0]
        reply: type[Reply] = get_args(base)[0]
        return reply


# Any command, whatever its reply.
Command = TypedCommand[Any]


@dataclass(frozen=True)
class NoReply:
    """The reply of a command without a result."""


@dataclass(frozen=True)
class EpochReply:
    """The reply of `reset`."""

    epoch: Annotated[int, "number of the new epoch"]


@dataclass(frozen=True)
class PausedReply:
    """The reply of `pause` and `resume`."""

    paused: Annotated[bool, "whether publishing is paused"]


@dataclass(frozen=True)
class TiltReply:
    """The reply of `tilt`."""

    tilt_deg: Tilt


@dataclass(frozen=True)
class LedReply:
    """The reply of `led`."""

    led: LedState


@dataclass(frozen=True)
class FolderReply:
    """The reply of the commands that write a folder."""

    folder: Annotated[str, "path on the service's computer"]


@dataclass(frozen=True)
class SavedMapReply:
    """The reply of `save-map`."""

    file: Annotated[
        str,
        "path on the service's computer; complete once `map.saved` in the status names it",
    ]
    keyframes: Annotated[int, "number of keyframes in the map"]


@dataclass(frozen=True)
class LoadedMapReply:
    """The reply of `load-map`."""

    file: Annotated[
        str, "path on the service's computer; loaded once `map.loaded` in the status names it"
    ]


@dataclass(frozen=True)
class ResetCommand(TypedCommand[EpochReply]):
    """Start a new epoch at the pose; without a pose, level at the origin."""

    command_name = "reset"
    required_together = ("position_m", "quaternion_xyzw")

    position_m: Annotated[
        Position | None,
        Field(
            "new position of the base in odom, x y z, meters",
            minimum=-MAX_POSITION_M,
            maximum=MAX_POSITION_M,
        ),
    ] = None
    quaternion_xyzw: Annotated[
        Quaternion | None,
        Field(
            "new orientation of the base, unit length",
            minimum=-1.0 - QUATERNION_NORM_TOLERANCE,
            maximum=1.0 + QUATERNION_NORM_TOLERANCE,
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        norm = math.hypot(*(self.quaternion_xyzw or (1.0,)))
        if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
            raise InputError("quaternion_xyzw must have length 1, as x y z w")

    @classmethod
    def to_pose(cls, T_odom_base: Array) -> "ResetCommand":
        """Make the command for a 4x4 pose of the base, meters.

        Raises:
            InputError: If it is not a finite rigid transform.
        """
        try:
            T = np.asarray(T_odom_base, dtype=np.float64)
        except (TypeError, ValueError):
            T = np.empty(0)
        if not is_rigid(T, RIGID_TOLERANCE):
            raise InputError(
                "T_odom_base: give a 4x4 matrix of finite numbers, a rotation and a position in "
                "meters"
            )
        x, y, z = T[:3, 3].tolist()
        qx, qy, qz, qw = quaternion_from_rotation(T[:3, :3]).tolist()
        return cls((x, y, z), (qx, qy, qz, qw))

    @property
    def T_odom_base(self) -> Array | None:
        """4x4 pose of the base at the start of the epoch; None: level, at the origin."""
        if self.position_m is None or self.quaternion_xyzw is None:
            return None
        return transform_from_pose(self.position_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class PauseCommand(TypedCommand[PausedReply]):
    """Stop publishing poses."""

    command_name = "pause"


@dataclass(frozen=True)
class ResumeCommand(TypedCommand[PausedReply]):
    """Publish poses again after `pause`."""

    command_name = "resume"


@dataclass(frozen=True)
class TiltCommand(TypedCommand[TiltReply]):
    """Tilt the sensor's head."""

    command_name = "tilt"

    tilt_deg: Tilt


@dataclass(frozen=True)
class LedCommand(TypedCommand[LedReply]):
    """Set the sensor's LED."""

    command_name = "led"

    led: LedState


@dataclass(frozen=True)
class StartRecordingCommand(TypedCommand[FolderReply]):
    """Record frames into a new folder, for `kinect-vo replay`."""

    command_name = "start-recording"

    name: Name


@dataclass(frozen=True)
class StopRecordingCommand(TypedCommand[FolderReply]):
    """End the recording."""

    command_name = "stop-recording"


@dataclass(frozen=True)
class SaveIncidentCommand(TypedCommand[FolderReply]):
    """Write the frames of the flight recorder into a folder."""

    command_name = "save-incident"


@dataclass(frozen=True)
class SaveMapCommand(TypedCommand[SavedMapReply]):
    """Mesh the keyframes of this epoch and save the map."""

    command_name = "save-map"

    name: Name


@dataclass(frozen=True)
class LoadMapCommand(TypedCommand[LoadedMapReply]):
    """Replace the keyframes by those of a saved map."""

    command_name = "load-map"

    name: Name


@dataclass(frozen=True)
class ReloadConfig(TypedCommand[NoReply]):
    """Apply a configuration that was read again. Only the program itself sends it.

    Attributes:
        apply: Applies the changes; called on the loop's thread.
    """

    apply: Callable[[], None]


# The commands over Zenoh, by name.
COMMANDS: Mapping[str, type[Command]] = {
    command.command_name: command
    for command in (
        ResetCommand,
        PauseCommand,
        ResumeCommand,
        TiltCommand,
        LedCommand,
        StartRecordingCommand,
        StopRecordingCommand,
        SaveIncidentCommand,
        SaveMapCommand,
        LoadMapCommand,
    )
}


def parse_command(name: str, payload: bytes) -> Command:
    """Parse a command.

    Args:
        name: Name of the command, such as "save-map".
        payload: Its arguments, a JSON object; empty: no arguments.

    Raises:
        CommandError: `UNKNOWN_COMMAND`, or `BAD_REQUEST` with the wrong argument.
    """
    if name not in COMMANDS:
        known = ", ".join(COMMANDS)
        raise CommandError(
            ErrorCode.UNKNOWN_COMMAND, f"there is no command {name!r}; there are: {known}"
        )
    command, arguments = COMMANDS[name], _parse_json_object(payload)
    try:
        return build_dataclass(command, arguments)
    except FieldError as error:
        argument = f"argument `{'.'.join(error.path)[:40]}` " if error.path else ""
        raise CommandError(ErrorCode.BAD_REQUEST, f"{argument}{error}") from error


def _parse_json_object(payload: bytes) -> Mapping[str, Any]:
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise CommandError(
            ErrorCode.BAD_REQUEST,
            f"{len(payload)} bytes are too many; the limit is {MAX_PAYLOAD_BYTES}",
        )
    try:
        values = json.loads(payload or b"{}")
    except (ValueError, RecursionError) as error:
        raise CommandError(ErrorCode.BAD_REQUEST, "the arguments are not JSON") from error
    if not isinstance(values, dict):
        raise CommandError(ErrorCode.BAD_REQUEST, "the arguments are not a JSON object")
    return values
