"""A camera that goes along a corner and comes back, as an odometry that drifts tells it."""

from dataclasses import replace

import numpy as np

from drivers.geometry import T_BODY_CAMERA, Array, inverse, rigid_transform, rotation_from_vector
from tests.vo_service.fakes import good
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.mapping.loops.hop import Hop
from vo_service.mapping.loops.loop_closer import LoopCloser, Sight
from vo_service.mapping.loops.opening import new_closer
from vo_service.pose_tracker import PoseTracker, StampedFrame
from vo_service.settings import MapSettings
from vo_service.types import PoseUpdate, TrackingState

# So many steps out, and as many back.
STEPS = 10
STEP = rigid_transform(rotation_from_vector([0.0, -0.02, 0.0]), [0.15, 0.0, 0.0])
DRIFT = rigid_transform(rotation_from_vector([0.0, 0.001, 0.0]), [0.004, 0.002, 0.0])
COVARIANCE = np.diag([5e-3**2] * 3 + [2e-3**2] * 3)


def truth(n: int) -> Array:
    """T_world_camera of the n-th place: out, back a little beside that, and out again."""
    way = STEPS - abs(n % (2 * STEPS) - STEPS)
    beside = rigid_transform(np.eye(3), [0.0, 0.02 if n > STEPS else 0.0, 0.0])
    return np.asarray(np.linalg.matrix_power(STEP, way) @ beside)


def told(n: int) -> Array:
    """The same as the odometry tells it."""
    return np.asarray(truth(n) @ np.linalg.matrix_power(DRIFT, n))


def sight(n: int, world: int = 0, T_world_truth: Array | None = None) -> Sight:
    """The n-th place, in a world that lies anywhere."""
    T = np.eye(4) if T_world_truth is None else T_world_truth
    hop = Hop(np.zeros(6), COVARIANCE, 0.15)
    return Sight(view_of_a_corner(truth(n), n), world, T @ told(n), hop)


def closer_after(count: int) -> LoopCloser:
    """A loop closer that has seen the first places."""
    closer = new_closer(MapSettings())
    for n in range(count):
        closer.see(sight(n))
    return closer


def error_m(closer: LoopCloser, number: int) -> float:
    """How far a place lies in the map from where it is, seen from the first."""
    T = inverse(closer.graph.T_map(0)) @ closer.graph.T_map(number)
    return float(np.linalg.norm(T[:3, 3] - truth(number)[:3, 3]))


def update(n: int, state: TrackingState = TrackingState.TRACKING, epoch: int = 0) -> PoseUpdate:
    """What the service says of the n-th place."""
    frame = replace(view_of_a_corner(truth(n), n), stamp_s=0.1 * n)
    stamped = StampedFrame(frame, frame.stamp_s)
    motion = inverse(told(n - 1)) @ told(n) if n else np.eye(4)
    estimate = replace(good(told(n), motion), covariance=COVARIANCE)
    said = PoseTracker().update(stamped, estimate, {}, 0.0)
    return replace(said, state=state, epoch=epoch, T_odom_camera=T_BODY_CAMERA @ told(n))
