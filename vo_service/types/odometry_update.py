"""The update that the service publishes of a frame."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.recording.odometry import OdometryRecord
from vo_service.types.estimate import Estimate, OnlineTiming
from vo_service.types.frame_scan import NO_SCAN, FrameScan
from vo_service.types.level import UNKNOWN_LEVEL, Level
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.occupancy_grid import NO_GRID, OccupancyGrid


class TrackingState(StrEnum):
    """Tracking state: how reliable a pose is."""

    TRACKING = "tracking"
    DEGRADED = "degraded"
    LOST = "lost"
    NO_CAMERA = "no_camera"


@dataclass(frozen=True)
class OdometryUpdate:
    """The result of one frame, as it goes to the outputs.

    Attributes:
        seq: Number of the update, from 0.
        stamp_s: The frame's stamp on the published clock, s (Unix time if live).
        state: Tracking state: how reliable the pose is.
        reason: Reason of the state; "" if tracking.
        epoch: Changes whenever the pose is not continuous with the previous one.
        T_world_camera: 4x4, optical axes; the world is the first camera. For trajectory files and
            viewers.
        T_odom_base: 4x4 pose of the base in `odom`, REP 103 axes. For robots. That of a planar base
            is level, whatever the camera's is.
        T_odom_camera: 4x4 pose of the optical camera in `odom`. For the mapper.
        pose_covariance: 6x6, accumulated since the start of the epoch, in axes of `odom`, ROS order
            (x y z rx ry rz).
        twist: (6,) velocity in the child frame, m/s and rad/s, ROS order.
        twist_covariance: 6x6 of this step, in the child frame, ROS order.
        estimate: The odometry's estimate of it.
        stage_ms: CPU time by stage, ms; that of deferred work is of the frame before.
        latency_s: Time from the frame's arrival to this result, s.
        level: How `odom` is kept level.
        map: The pose graph, with the transform of `odom` in the map.
        grid: The occupancy grid of the map.
        scan: The scan of the frame, made if somebody asks for it.
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
    level: Level = UNKNOWN_LEVEL
    map: MapSnapshot = NO_MAP
    grid: OccupancyGrid = NO_GRID
    scan: FrameScan = NO_SCAN

    @property
    def is_localized(self) -> bool:
        """Whether the transform of this pose's `odom` in the map is known; True without a map."""
        return self.map.is_localized_in(self.epoch)

    @property
    def timing(self) -> OnlineTiming:
        """The sensor's timing in use: the frame's own, exactly, where the odometry learns none."""
        return self.estimate.timing or OnlineTiming(self.frame.readout_s, 0.0, 0.0, 0.0, "")


# Adds the scan to an update.
AddScan = Callable[[OdometryUpdate], OdometryUpdate]


def add_no_scan(update: OdometryUpdate) -> OdometryUpdate:
    """Return the update: nobody may have a scan."""
    return update


# Returns the messages of the wheels since its last call.
WheelMessageSource = Callable[[], Sequence[OdometryRecord]]


@dataclass(frozen=True)
class UpdateWithWheels:
    """An update, and the messages of the wheels since the one before, for a recording."""

    update: OdometryUpdate
    wheel_messages: Sequence[OdometryRecord]
