"""What the service hands to its outputs, and what each output has."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from drivers.camera import CameraState, RgbdFrame
from drivers.geometry import Array
from drivers.trajectory import StampedPoses
from vo_service.odometry.estimate import Estimate
from vo_service.outputs.map_snapshot import NO_MAP, MapSnapshot


class TrackingState(StrEnum):
    """How far a pose can be trusted."""

    TRACKING = "tracking"
    DEGRADED = "degraded"
    LOST = "lost"
    NO_CAMERA = "no_camera"


class Level(StrEnum):
    """How it is known which way is up in `odom`."""

    GRAVITY = "gravity"  # an accelerometer told it at the first frame
    ASSUMED = "assumed"  # the base's first pose counts as level


@dataclass(frozen=True)
class PoseUpdate:
    """One frame's result, ready to go out.

    seq                 counts published poses from 0
    stamp_s             the frame's stamp on the published clock (Unix seconds when live)
    state, reason       how far the pose can be trusted and, unless tracking, why
    epoch               changes whenever the pose is not continuous with the one before
    T_world_camera      4x4, optical axes, world = first camera: for trajectory files and pictures
    T_odom_base         4x4, REP 103 axes: for robots
    T_odom_camera       4x4, the optical camera in `odom`: for what lies there, or in the map
    pose_covariance     6x6 accumulated since the epoch began, odom axes, ROS order (x y z rx ry rz)
    twist               (6,) m/s and rad/s in the child frame, ROS order
    twist_covariance    6x6 of this step, child frame, ROS order
    stage_ms            CPU milliseconds by stage
    latency_s           from the frame's arrival to this result
    map                 of places, and how `odom` lies in it
    """

    seq: int
    stamp_s: float
    state: TrackingState
    reason: str
    epoch: int
    T_world_camera: Array
    T_odom_base: Array
    T_odom_camera: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array
    frame: RgbdFrame
    estimate: Estimate
    stage_ms: Mapping[str, float]
    latency_s: float
    map: MapSnapshot = NO_MAP

    @property
    def is_located(self) -> bool:
        """Whether it is known where the `odom` of this very pose lies in the map, if there is one.

        A map that was made before the epoch began does not know.
        """
        the_map = self.map
        return the_map is NO_MAP or (the_map.is_located and the_map.epoch == self.epoch)


@dataclass(frozen=True)
class Status:
    """How the service is, as it goes out in JSON. `reason` is "" while all is well.

    camera_state  how far the camera is from sending frames
    intrinsics    where they come from: "camera file FILE", "factory", "default"; "" = exact
    level         how it is known which way is up; assumed until the first frame says
    skew_ms       instant of depth minus instant of colour, median of the last frames
    jitter_ms     standard deviation of the time from one stamp to the next
    paused        asked to publish no poses
    recording     folder that is being recorded into; "" = none
    map_keyframes, saving_map, saved_map, loading_map, loaded_map  see
                  `vo_service.mapping.live.contract.MapState`
    places, loops see `MapSnapshot`
    is_located    see `PoseUpdate`; of the last one
    warnings      what the outputs complain of, and what was given up for want of time
    cpu_ms_per_frame, stage_ms  processor time of the odometry, whole and by stage: medians
    stage_mean_ms, stage_budget_ms  the mean of all frames, and what it may be
    """

    state: TrackingState
    reason: str
    epoch: int
    camera: str
    camera_state: CameraState
    intrinsics: str
    level: Level
    method: str
    fps: float
    latency_p50_ms: float
    latency_p99_ms: float
    skew_ms: float
    jitter_ms: float
    features: int
    matches: int
    inliers: int
    frames: int
    failed: int
    dropped: int
    skipped: int
    lost_packets: int
    paused: bool = False
    recording: str = ""
    map_keyframes: int = 0
    saving_map: str = ""
    saved_map: str = ""
    loading_map: str = ""
    loaded_map: str = ""
    places: int = 0
    loops: int = 0
    is_located: bool = True
    warnings: tuple[str, ...] = ()
    cpu_ms_per_frame: float = 0.0
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    stage_mean_ms: Mapping[str, float] = field(default_factory=dict)
    stage_budget_ms: Mapping[str, float] = field(default_factory=dict)


# Asked for the ground truth once frames come: a live camera's truth has no stamps before that.
TruthSource = Callable[[], StampedPoses | None]


def no_truth() -> StampedPoses | None:
    """Where the truth is not known."""
    return None


class Troubled(Protocol):
    """Something that may have a complaint for the status."""

    @property
    def warning(self) -> str:
        """One clause that says what is wrong with it now; "" while all is well."""
        ...


class Output(Troubled, Protocol):
    """Somewhere that poses go. None of the three blocks the caller for long.

    `pose` and `status` never raise: an output that fails logs it once, and says so in `warning`.
    """

    def pose(self, update: PoseUpdate) -> None:
        """Take one result."""
        ...

    def status(self, status: Status) -> None:
        """Take the service's status: twice a second and on change."""
        ...

    def close(self) -> None:
        """Finish what was taken and release everything. Safe to call twice.

        Raises UserFacingError, the first time, if something taken could not be kept.
        """
        ...
