"""The status of the service: what is published twice a second, in groups, with its descriptions."""

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Annotated

from drivers.camera import CameraState
from vo_service.types.update import LevelSource, TrackingState

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
        str, 'source of the intrinsics: "camera file FILE", "factory", "default"; "" = exact'
    ]
    level: Annotated[
        LevelSource, "source of the up direction: measured, or the first pose counts as level"
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
    timing: Annotated[
        str,
        'source of readout and depth offset: "learned", "camera file", "memory" (learned at an '
        'earlier run), "usual for the sensor", "unknown"; "" = exact, or fixed',
    ] = ""
    focal_scale: Annotated[
        float, "focal length in use of the color camera, relative to the intrinsics"
    ] = 1.0
    focal_scale_sigma: Annotated[float, "its standard deviation; 0 = exact, or fixed"] = 0.0
    focal_disagreement: Annotated[
        float,
        "the same by depth minus that by brightness: far from 0, the calibration is wrong; "
        "0 = not known",
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
class TimingReport:
    """How fast poses come, and the CPU time of the odometry."""

    fps: Annotated[float, "poses per second, over the last two seconds"] = 0.0
    latency_p50_ms: Annotated[
        float, "from a frame's arrival to its pose, median of the last 100 frames"
    ] = 0.0
    latency_p99_ms: Annotated[float, "the same, 99th percentile"] = 0.0
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
    tracking: Annotated[TrackingReport, "the odometry and its last frame"]
    timing: Annotated[TimingReport, "how fast poses come, and the CPU time of the odometry"]
    map: Annotated[MapReport, "loop closure, localization, saved and loaded maps"]
    recorder: Annotated[RecorderReport, "the recorder"]


def versions() -> dict[str, str]:
    """Return the versions by name."""
    packages = ("kinect-vo", "eclipse-zenoh", "numpy", "numba", "opencv-python-headless")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}
