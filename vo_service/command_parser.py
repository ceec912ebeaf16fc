"""Command parser: read a command with its arguments from JSON."""

import json
import re
import sys
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np

from drivers.camera import Led
from drivers.core.geometry import transform_from_pose
from vo_service.types import (
    NAME_PATTERN,
    Command,
    CommandError,
    ErrorCode,
    LedCommand,
    LoadMapCommand,
    PauseCommand,
    ResetCommand,
    ResumeCommand,
    SaveIncidentCommand,
    SaveMapCommand,
    StartRecordingCommand,
    StopRecordingCommand,
    TiltCommand,
)

MAX_PAYLOAD_BYTES = 4096
# Limit of a coordinate in `reset`, m.
MAX_POSITION_M = 1e6
MAX_TILT_DEG = 31.0
# A quaternion this far from length 1 is a mistake, not rounding.
QUATERNION_NORM_TOLERANCE = 1e-2


def parse_command(name: str, payload: bytes) -> Command:
    """Parse a command.

    Args:
        name: Name of the command, such as "save-map".
        payload: Its arguments, a JSON object; empty: no arguments.

    Raises:
        CommandError: `UNKNOWN_COMMAND`, or `BAD_REQUEST` with the wrong argument.
    """
    if name not in _PARSERS:
        raise CommandError(
            ErrorCode.UNKNOWN_COMMAND,
            f"there is no command {name!r}; there are: {_known_commands()}",
        )
    arguments = _Arguments(name, _parse_json_object(payload))
    command = _PARSERS[name](arguments)
    arguments.reject_unknown()
    return command


class _Arguments:
    """Takes arguments from a JSON object one by one, and checks each."""

    def __init__(self, command: str, values: Mapping[str, Any]) -> None:
        self._command = command
        self._values = dict(values)
        self._known: list[str] = []

    def has(self, key: str) -> bool:
        """Whether an argument was given."""
        self._known.append(key)
        return key in self._values

    def take_number(self, key: str, limit: float) -> float:
        """Take a finite number from -limit to limit."""
        value = self._take(key)
        if not _is_number(value) or abs(value) > limit:
            self.reject(key, f"must be a number from {-limit:g} to {limit:g}")
        return float(value)

    def take_numbers(self, key: str, count: int, limit: float) -> tuple[float, ...]:
        """Take a list of `count` finite numbers from -limit to limit."""
        values = self._take(key)
        is_right = isinstance(values, list) and len(values) == count
        if not is_right or not all(_is_number(v) and abs(v) <= limit for v in values):
            self.reject(key, f"must be a list of {count} numbers from {-limit:g} to {limit:g}")
        return tuple(float(v) for v in values)

    def take_text(self, key: str, pattern: str, wanted: str) -> str:
        """Take a text that matches a pattern; `wanted` describes the pattern."""
        value = self._take(key)
        if not isinstance(value, str) or not re.fullmatch(pattern, value):
            self.reject(key, f"must be {wanted}")
        return value

    def reject_unknown(self) -> None:
        """Reject arguments that this command does not have."""
        for key in self._values:
            known = ", ".join(dict.fromkeys(self._known)) or "none"
            self.reject(key, f"is not an argument of {self._command}; it takes: {known}")

    def reject(self, key: str, reason: str) -> NoReturn:
        """Raise CommandError for an argument."""
        raise CommandError(ErrorCode.BAD_REQUEST, f"argument {key[:40]!r} {reason}")

    def _take(self, key: str) -> Any:
        self._known.append(key)
        if key not in self._values:
            self.reject(key, "is missing")
        return self._values.pop(key)


def _parse_reset(arguments: _Arguments) -> ResetCommand:
    if not arguments.has("position_m") and not arguments.has("quaternion_xyzw"):
        return ResetCommand()
    position_m = arguments.take_numbers("position_m", 3, MAX_POSITION_M)
    quaternion = arguments.take_numbers("quaternion_xyzw", 4, 1.0 + QUATERNION_NORM_TOLERANCE)
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > QUATERNION_NORM_TOLERANCE:
        arguments.reject("quaternion_xyzw", "must have length 1, as x y z w")
    return ResetCommand(transform_from_pose(position_m, quaternion))


def _parse_tilt(arguments: _Arguments) -> TiltCommand:
    return TiltCommand(arguments.take_number("tilt_deg", MAX_TILT_DEG))


def _parse_led(arguments: _Arguments) -> LedCommand:
    return LedCommand(Led(arguments.take_text("led", "|".join(Led), f"one of {', '.join(Led)}")))


def _parse_name(arguments: _Arguments) -> str:
    wanted = "a plain name: up to 64 letters, digits, '_', '-' or '.', a letter or digit first"
    return arguments.take_text("name", NAME_PATTERN, wanted)


_PARSERS: Mapping[str, Callable[[_Arguments], Command]] = {
    "reset": _parse_reset,
    "pause": lambda _: PauseCommand(),
    "resume": lambda _: ResumeCommand(),
    "tilt": _parse_tilt,
    "led": _parse_led,
    "start-recording": lambda arguments: StartRecordingCommand(_parse_name(arguments)),
    "stop-recording": lambda _: StopRecordingCommand(),
    "save-incident": lambda _: SaveIncidentCommand(),
    "save-map": lambda arguments: SaveMapCommand(_parse_name(arguments)),
    "load-map": lambda arguments: LoadMapCommand(_parse_name(arguments)),
}
COMMAND_NAMES = tuple(_PARSERS)


def _known_commands() -> str:
    return ", ".join(_PARSERS)


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


def _is_number(value: Any) -> bool:
    # Not `isfinite`: it raises OverflowError for whole numbers of hundreds of digits.
    return type(value) in (int, float) and -sys.float_info.max <= value <= sys.float_info.max
