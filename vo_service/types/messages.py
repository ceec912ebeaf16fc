"""The JSON messages around poses and commands, and their encoding.

Outgoing messages may get more fields without a new schema number; a change that breaks readers
raises the number.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Annotated, Any, TypeVar, get_args, get_origin

from drivers.core.fields import Field, TypedField, typed_fields
from vo_service.types.commands import ErrorCode
from vo_service.types.status import (
    STATE_DESCRIPTION,
    EpochNumber,
    IsLocalized,
    KeyframeCount,
    LoopClosureCount,
)
from vo_service.types.update import TrackingState

MESSAGE_SCHEMA = 1
POSE_STATES = (TrackingState.TRACKING, TrackingState.DEGRADED, TrackingState.LOST)
T = TypeVar("T")
JsonObject = Mapping[str, Any]


@dataclass(frozen=True)
class OdomAttachment:
    """Attachment of a pose on PREFIX/odom and PREFIX/latest."""

    seq: Annotated[int, Field("number of the pose, from 0 at each start of the service", minimum=0)]
    state: Annotated[
        TrackingState,
        Field(STATE_DESCRIPTION, choices=POSE_STATES),
    ]
    epoch: EpochNumber
    reason: Annotated[str, 'reason of the state or of a new epoch; "" if there is none']


@dataclass(frozen=True)
class MapOdomAttachment:
    """Attachment of the map->odom transform, on PREFIX/map_odom."""

    seq: Annotated[int, Field("number of the newest pose, which has the same stamp", minimum=0)]
    epoch: Annotated[int, "epoch of that pose; the transform is invalid for other epochs"]
    is_localized: IsLocalized
    map_keyframes: KeyframeCount
    loop_closures: LoopClosureCount


@dataclass(frozen=True)
class FrameAttachment:
    """Attachment of every topic of a frame: images, points and others."""

    seq: Annotated[int, Field("number of the pose with the same stamp", minimum=0)]
    camera_position_m: Annotated[
        tuple[float, float, float], "position of the optical camera in the base, m"
    ]
    camera_quaternion_xyzw: Annotated[
        tuple[float, float, float, float], "orientation of the optical camera in the base"
    ]


@dataclass(frozen=True)
class TimingMessage:
    """The sensor's timing and focal length in use, on PREFIX/timing."""

    stamp_s: Annotated[float, "stamp of the frame, Unix time"]
    readout_s: Annotated[float, "rolling shutter: from the first row to the last, s"]
    readout_sigma_s: Annotated[float, "its standard deviation, s; 0 = exact, or fixed"]
    depth_offset_s: Annotated[float, "capture time of depth minus its stamp, relative to color, s"]
    depth_offset_sigma_s: Annotated[float, "its standard deviation, s; 0 = exact, or fixed"]
    source: Annotated[str, 'source of the four, as in the status; "" = exact, or fixed']
    focal_scale: Annotated[float, "focal length in use, relative to the intrinsics"]
    focal_scale_sigma: Annotated[float, "its standard deviation; 0 = exact, or fixed"]


@dataclass(frozen=True)
class ErrorReply:
    """Error reply to a query or a command."""

    error: Annotated[ErrorCode, "error code, for programs"]
    message: Annotated[str, "error message, for people"]


def encode_message(message: Any, extra_fields: JsonObject | None = None) -> bytes:
    """Encode a dataclass as a JSON message with the schema number.

    Args:
        message: The dataclass.
        extra_fields: Fields that are not of the dataclass.

    Raises:
        ValueError: If a number is not finite.
    """
    content = {"schema": MESSAGE_SCHEMA, **asdict(message), **(extra_fields or {})}
    return json.dumps(content, allow_nan=False).encode()


def parse_json_message(payload: bytes) -> JsonObject:
    """Parse a JSON message.

    Raises:
        ValueError: If it is not valid JSON, or of an unknown version.
    """
    try:
        content = json.loads(payload)
    except RecursionError as error:
        raise ValueError("a message is nested too deeply") from error
    version = content.get("schema") if isinstance(content, dict) else None
    if version != MESSAGE_SCHEMA:
        raise ValueError(
            f"a message has version {version}, but this client reads only {MESSAGE_SCHEMA}; use "
            "the client of the service's version"
        )
    message: JsonObject = content
    return message


def decode_message(kind: type[T], content: JsonObject, what: str) -> T:
    """Convert a parsed message to its dataclass. Fields that are not of the dataclass are ignored.

    Args:
        kind: The dataclass, such as `OdomAttachment`.
        content: The message.
        what: What the message is, for errors, such as "a pose".

    Raises:
        ValueError: If a field is missing or has another type.
    """
    fields = typed_fields(kind)
    missing = {field.name for field in fields} - content.keys()
    if missing:
        raise ValueError(f"{what} came without {', '.join(sorted(missing))}")
    return kind(**{field.name: _decode(field, content[field.name], what) for field in fields})


def _decode(field: TypedField, value: Any, what: str) -> Any:
    kind = get_origin(field.kind) or field.kind
    if kind is tuple and isinstance(value, list) and len(value) == len(get_args(field.kind)):
        return tuple(map(float, value))
    json_kind = str if issubclass(kind, StrEnum) else kind
    if json_kind is float and type(value) is int:
        return float(value)
    if type(value) is not json_kind:  # isinstance(True, int) holds
        found, expected = type(value).__name__, json_kind.__name__
        raise ValueError(f"{what} came with a {found} for {field.name}, not {expected}")
    return kind(value)
