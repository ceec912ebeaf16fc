"""What the service publishes of each frame: the pose, how far it can be trusted, and why."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.types.estimate import Estimate
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot


class TrackingState(StrEnum):
    """How far a pose can be trusted."""

    TRACKING = "tracking"
    DEGRADED = "degraded"
    LOST = "lost"
    NO_CAMERA = "no_camera"


class LevelSource(StrEnum):
    """How it is known which way is up in `odom`."""

    GRAVITY = "gravity"  # an accelerometer told it at the first frame
    ASSUMED = "assumed"  # the base's first pose counts as level


@dataclass(frozen=True)
class OdometryUpdate:
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
    def is_localized(self) -> bool:
        """Whether it is known where the `odom` of this very pose lies in the map, if there is one.

        A map that was made before the epoch began does not know.
        """
        the_map = self.map
        return the_map is NO_MAP or (the_map.is_localized and the_map.epoch == self.epoch)
