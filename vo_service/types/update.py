"""One frame's result: the pose, how far it can be trusted, and the map at that moment."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.types.estimate import Estimate


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """Nothing in it ever changes: another map is another object.

    T_map_odom      4x4, how `odom` lies in the map: what the places that are known again say
    epoch           of the poses that this is for: a `reset` lays `odom` elsewhere at once, and the
                    map knows of it some frames later
    T_map_place     (N, 4, 4) optical camera at each place, in REP 103 axes of the map; the newest
                    is the last
    edges           (M, 2) int32, rows of `T_map_keyframe` that are joined
    is_loop         (M,) bool: joined because a place was known again, not by the odometry
    is_localized      False where a map was loaded, or there was a loss, and no place of the map has
                    been known again since: `odom` then lies anywhere
    """

    T_map_odom: Array = field(default_factory=lambda: np.eye(4))
    T_map_keyframe: Array = field(default_factory=lambda: np.empty((0, 4, 4)))
    edges: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), np.int32))
    is_loop_closure: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    is_localized: bool = True
    epoch: int = 0

    @property
    def keyframes(self) -> int:
        """How many there are."""
        return len(self.T_map_keyframe)

    @property
    def loop_closures(self) -> int:
        """How often a place was known again."""
        return int(np.count_nonzero(self.is_loop_closure))


NO_MAP = MapSnapshot()


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
