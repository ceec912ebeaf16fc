"""The messages: the status in groups, and what is published of an update, in JSON or CDR.

Outgoing JSON messages may get more fields without a new schema number; a change that breaks readers
raises the number.
"""

import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from importlib.metadata import version
from typing import Annotated, Any, TypeVar, get_args, get_origin

import numpy as np

from drivers.camera import CameraState
from drivers.core.config import Field, TypedField, typed_fields
from drivers.core.geometry import Array, quaternion_from_rotation
from drivers.ros_messages.navigation import (
    OccupancyGridMessage,
    OdometryMessage,
    TransformMessage,
    encode_occupancy_grid,
    encode_odometry,
    encode_transform,
)
from vo_service.config_tables import FrameIds
from vo_service.types.commands import ErrorCode
from vo_service.types.estimate import OnlineFocalLength
from vo_service.types.level import LevelSource
from vo_service.types.map_snapshot import NO_MAP
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

# Fields that other messages have too.
EpochNumber = Annotated[int, "changes whenever the pose is not continuous with the one before"]
KeyframeCount = Annotated[int, "keyframes for place recognition"]
LoopClosureCount = Annotated[int, "loop closures that corrected the map"]
IsLocalized = Annotated[
    bool,
    "whether the map->odom transform is known: false after a reset, a loss or the load of a map, "
    "until relocalization succeeds",
]
STATE_DESCRIPTION = "tracking state: how far the pose can be trusted"


@dataclass(frozen=True)
class MapState:
    """The mapper's state.

    Attributes:
        mesh_keyframes: Number of keyframes that a map would be made of now.
        saving: File of the map that is being saved; "" = none.
        saved: File of the last map that was saved completely; "" = none.
        loading: File of the map that is being loaded; "" = none.
        loaded: File of the map that is loaded; "" = none.
    """

    mesh_keyframes: int = 0
    saving: str = ""
    saved: str = ""
    loading: str = ""
    loaded: str = ""


@dataclass(frozen=True)
class CameraReport:
    """The camera and its frames."""

    name: Annotated[str, "name of the camera"]
    state: Annotated[CameraState, "connection state of the camera"]
    intrinsics: Annotated[
        str,
        'source of the intrinsics: "camera file FILE", a topic of a bag, "factory", "default"; '
        '"" = exact',
    ]
    skew_ms: Annotated[
        float, "stamp of depth minus stamp of color, median of the last 100 frames"
    ] = 0.0
    jitter_ms: Annotated[float, "standard deviation of the time between two stamps"] = 0.0
    dropped: Annotated[int, "frames dropped because a newer one was available"] = 0
    skipped: Annotated[int, "frames skipped because they were not usable"] = 0
    lost_packets: Annotated[int, "packets lost between the sensor and the computer"] = 0
    readout_ms: Annotated[float, "rolling shutter: from the first row to the last"] = 0.0
    readout_sigma_ms: Annotated[float, "its standard deviation; 0 = exact"] = 0.0
    depth_offset_ms: Annotated[
        float, "capture time of depth minus its stamp, relative to color"
    ] = 0.0
    depth_offset_sigma_ms: Annotated[float, "its standard deviation; 0 = exact"] = 0.0
    sensor_timing_source: Annotated[
        str,
        'source of readout and depth offset: "learned", "camera file", "memory" (learned at an '
        'earlier run), "usual for the sensor", "unknown"; "" = exact, or fixed',
    ] = ""
    focal_scale: Annotated[
        float, "focal length in use of the color camera, relative to the intrinsics"
    ] = 1.0
    focal_scale_sigma: Annotated[float, "its standard deviation; 0 = exact, or fixed"] = 0.0
    focal_source: Annotated[
        str,
        'source of that focal length: "intrinsics", "memory" (learned at an earlier run), '
        '"learned"; "" = exact, or fixed',
    ] = ""
    focal_disagreement: Annotated[
        float,
        "the same by depth minus that by brightness: far from 0, the calibration is wrong; "
        "0 = not known",
    ] = 0.0
    sensor_timing_refused: Annotated[
        bool, "a learned timing is not used, as frames fit no better with it"
    ] = False
    focal_refused: Annotated[
        bool, "a learned focal length is not used, as frames fit no better with it"
    ] = False
    depth_noise_per_m: Annotated[
        float,
        "learned standard deviation of inverse depth, 1/m: that of depth is z^2 times it; "
        "0 = not known",
    ] = 0.0


@dataclass(frozen=True)
class LevelReport:
    """How `odom` is kept level."""

    source: Annotated[
        LevelSource,
        "source of the up direction: the floor in view, the mount of a planar base, the "
        "accelerometer; assumed = the first pose counts as level",
    ] = LevelSource.ASSUMED
    tilt_deg: Annotated[float, "angle between the z axis of the base and up"] = 0.0
    tilt_sigma_deg: Annotated[float, "standard deviation of the up direction; 0 = not known"] = 0.0
    camera_height_m: Annotated[
        float, "of the camera above the floor that was last in view; 0 = not known"
    ] = 0.0


@dataclass(frozen=True)
class TrackingReport:
    """The odometry and its last frame."""

    method: Annotated[str, "name of the odometry"]
    features: Annotated[int, "features in the last frame"] = 0
    matches: Annotated[int, "features matched with the previous frame"] = 0
    inliers: Annotated[int, "matches that agree on one motion"] = 0
    frames: Annotated[int, "frames processed since the start"] = 0
    failed: Annotated[int, "processed frames without a motion estimate"] = 0


@dataclass(frozen=True)
class LatencyReport:
    """How fast poses come, and the CPU time of the odometry."""

    fps: Annotated[float, "poses per second, over the last two seconds"] = 0.0
    p50_ms: Annotated[
        float, "from a frame's arrival to its pose, median of the last 100 frames"
    ] = 0.0
    p99_ms: Annotated[float, "the same, 99th percentile"] = 0.0
    cpu_ms_per_frame: Annotated[
        float, "CPU time of the odometry, median of the last 100 frames"
    ] = 0.0
    stage_ms: Annotated[
        Mapping[str, float], "the same by stage, over the frames in which it ran"
    ] = field(default_factory=dict)
    stage_mean_ms: Annotated[
        Mapping[str, float], "mean of the last 100 frames by stage; the sum is the cost of a frame"
    ] = field(default_factory=dict)
    stage_budget_ms: Annotated[
        Mapping[str, float], "limit of each stage; empty for a method without a budget"
    ] = field(default_factory=dict)


@dataclass(frozen=True)
class MapReport:
    """The map: loop closure, localization, and the files that are saved and loaded."""

    keyframes: KeyframeCount = 0
    loop_closures: LoopClosureCount = 0
    is_localized: IsLocalized = True
    mesh_keyframes: Annotated[int, "keyframes that a map would be made of now"] = 0
    saving: Annotated[str, 'file of the map that is being saved; "" = none'] = ""
    saved: Annotated[
        str, 'file of the last map that was saved completely; "" = none since the start'
    ] = ""
    loading: Annotated[str, 'file of the map that is being loaded; "" = none'] = ""
    loaded: Annotated[str, 'file of the map that is loaded; "" = none since the start'] = ""


@dataclass(frozen=True)
class RecorderReport:
    """The recorder."""

    recording: Annotated[str, 'folder of the current recording; "" = none'] = ""


@dataclass(frozen=True)
class Status:
    """The status of the service, as it is published in JSON.

    To add a field, declare it here or in a group above, and set it in `Service._make_status`.
    """

    state: Annotated[TrackingState, STATE_DESCRIPTION]
    reason: Annotated[str, 'reason of the state, for people; "" if there is none']
    epoch: EpochNumber
    paused: Annotated[bool, "whether publishing is paused"]
    warnings: Annotated[tuple[str, ...], "faults other than tracking, one clause each"]
    camera: Annotated[CameraReport, "the camera and its frames"]
    level: Annotated[LevelReport, "how odom is kept level"]
    tracking: Annotated[TrackingReport, "the odometry and its last frame"]
    latency: Annotated[LatencyReport, "how fast poses come, and the CPU time of the odometry"]
    map: Annotated[MapReport, "loop closure, localization, saved and loaded maps"]
    recorder: Annotated[RecorderReport, "the recorder"]


def versions() -> dict[str, str]:
    """Return the versions by name."""
    packages = ("kinect-vo", "eclipse-zenoh", "numpy", "numba", "opencv-python-headless")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


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


# A dataclass becomes an object of its fields. `asdict` copies each value first.
_JSON = json.JSONEncoder(allow_nan=False, default=vars)


def encode_message(message: Any, extra_fields: JsonObject | None = None) -> bytes:
    """Encode a dataclass as a JSON message with the schema number.

    Args:
        extra_fields: Fields that are not of the dataclass.

    Raises:
        ValueError: If a number is not finite.
    """
    content = {"schema": MESSAGE_SCHEMA, **vars(message), **(extra_fields or {})}
    return _JSON.encode(content).encode()


def pose_payload(update: OdometryUpdate, frame_ids: FrameIds) -> bytes:
    """Encode the pose as CDR ``nav_msgs/msg/Odometry``.

    Raises:
        ValueError: A number is not finite.
    """
    return encode_odometry(
        OdometryMessage(
            stamp_s=update.stamp_s,
            frame_id=frame_ids.odom_frame_id,
            child_frame_id=frame_ids.base_frame_id,
            T_frame_child=update.T_odom_base,
            pose_covariance=update.pose_covariance,
            twist=update.twist,
            twist_covariance=update.twist_covariance,
        )
    )


def pose_attachment(update: OdometryUpdate) -> bytes:
    """Encode the JSON attachment of a pose: what `Odometry` has no field for."""
    return encode_message(OdomAttachment(update.seq, update.state, update.epoch, update.reason))


def map_odom_transform(update: OdometryUpdate, frame_ids: FrameIds) -> TransformMessage:
    """Make the map->odom transform at the stamp of this pose."""
    names = frame_ids.map_frame_id, frame_ids.odom_frame_id
    return TransformMessage(update.stamp_s, *names, update.map.T_map_odom)


def pose_transforms(update: OdometryUpdate, frame_ids: FrameIds) -> list[TransformMessage]:
    """Make odom->base and, if it is known, map->odom; nothing while lost.

    A transform has no covariance, so an uncertain one must be absent. A bad map does not hold up
    odom->base.
    """
    if update.state is TrackingState.LOST:
        return []
    base = TransformMessage(
        update.stamp_s, frame_ids.odom_frame_id, frame_ids.base_frame_id, update.T_odom_base
    )
    is_map_known = update.map is not NO_MAP and update.is_localized
    if not is_map_known or not np.all(np.isfinite(update.map.T_map_odom)):
        return [base]
    return [base, map_odom_transform(update, frame_ids)]


def map_odom_payload(update: OdometryUpdate, frame_ids: FrameIds) -> bytes:
    """Encode the map->odom transform as CDR ``geometry_msgs/msg/TransformStamped``.

    Raises:
        ValueError: A number is not finite.
    """
    return encode_transform(map_odom_transform(update, frame_ids))


def grid_payload(update: OdometryUpdate, frame_ids: FrameIds) -> bytes:
    """Encode the occupancy grid as CDR ``nav_msgs/msg/OccupancyGrid``.

    Raises:
        ValueError: A number is not finite.
    """
    grid = update.grid
    return encode_occupancy_grid(
        OccupancyGridMessage(
            update.stamp_s, frame_ids.map_frame_id, grid.resolution_m, grid.origin_xy_m, grid.cells
        )
    )


def map_odom_message(update: OdometryUpdate, frame_ids: FrameIds) -> tuple[bytes, bytes]:
    """Encode the map->odom transform and its attachment. Raises as `map_odom_payload`."""
    return map_odom_payload(update, frame_ids), map_odom_attachment(update)


def map_odom_attachment(update: OdometryUpdate) -> bytes:
    """Encode the JSON attachment of the map->odom transform."""
    return encode_message(
        MapOdomAttachment(
            update.seq,
            update.epoch,
            update.is_localized,
            update.map.keyframes,
            update.map.loop_closures,
        )
    )


def timing_payload(update: OdometryUpdate) -> bytes:
    """Encode the sensor's timing and focal length in use as JSON."""
    timing = update.timing
    focal_length = update.estimate.focal_length or OnlineFocalLength(1.0, 0.0, None)
    return encode_message(
        TimingMessage(
            stamp_s=update.stamp_s,
            readout_s=timing.readout_s,
            readout_sigma_s=timing.readout_sigma_s,
            depth_offset_s=timing.depth_offset_s,
            depth_offset_sigma_s=timing.depth_offset_sigma_s,
            source=timing.source,
            focal_scale=focal_length.scale,
            focal_scale_sigma=focal_length.sigma,
        )
    )


def frame_attachment(update: OdometryUpdate, T_base_camera: Array) -> bytes:
    """Encode the JSON attachment: the pose's number, and where the camera is in the base."""
    x, y, z = T_base_camera[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_from_rotation(T_base_camera[:3, :3]).tolist()
    return encode_message(FrameAttachment(update.seq, (x, y, z), (qx, qy, qz, qw)))


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
