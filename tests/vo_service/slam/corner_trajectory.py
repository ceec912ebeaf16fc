"""A camera that moves along a corner and back, with a drifting odometry."""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import T_BODY_CAMERA, Array, inverse, rigid_transform, so3_exp
from tests.vo_service.fakes import good_estimate
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.slam.keyframe_selection import OdometryConstraint
from vo_service.slam.loop_closer import KeyframeObservation, LoopCloser
from vo_service.slam.synchronous_loop_closure import create_loop_closer
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

# Number of steps out, and back.
STEPS = 10
STEP = rigid_transform(so3_exp([0.0, -0.02, 0.0]), [0.15, 0.0, 0.0])
DRIFT = rigid_transform(so3_exp([0.0, 0.001, 0.0]), [0.004, 0.002, 0.0])
COVARIANCE = np.diag([5e-3**2] * 3 + [2e-3**2] * 3)


def true_pose(n: int) -> Array:
    """T_world_camera of the n-th keyframe: out, back slightly beside, and out again."""
    way = STEPS - abs(n % (2 * STEPS) - STEPS)
    beside = rigid_transform(np.eye(3), [0.0, 0.02 if n > STEPS else 0.0, 0.0])
    return np.asarray(np.linalg.matrix_power(STEP, way) @ beside)


def odometry_pose(n: int) -> Array:
    """The pose by the odometry."""
    return np.asarray(true_pose(n) @ np.linalg.matrix_power(DRIFT, n))


def make_observation(
    n: int, world: int = 0, T_world_truth: Array | None = None
) -> KeyframeObservation:
    """The n-th keyframe, in a world frame with any pose."""
    T = np.eye(4) if T_world_truth is None else T_world_truth
    constraint = OdometryConstraint(np.zeros(6), COVARIANCE, 0.15)
    return KeyframeObservation(
        render_corner(true_pose(n), n), world, T @ odometry_pose(n), constraint
    )


def make_loop_closer(count: int) -> LoopCloser:
    """A loop closer with the first keyframes."""
    closer = create_loop_closer(MapConfig())
    for n in range(count):
        closer.process_keyframe(make_observation(n))
    return closer


def keyframe_error_m(closer: LoopCloser, number: int) -> float:
    """Position error of a keyframe in the map relative to the first one."""
    T = inverse(closer.graph.T_map_keyframe(0)) @ closer.graph.T_map_keyframe(number)
    return float(np.linalg.norm(T[:3, 3] - true_pose(number)[:3, 3]))


def make_update(
    n: int, state: TrackingState = TrackingState.TRACKING, epoch: int = 0
) -> OdometryUpdate:
    """The service's update of the n-th keyframe."""
    frame = replace(render_corner(true_pose(n), n), stamp_s=0.1 * n)
    stamped = StampedFrame(frame, frame.stamp_s)
    motion = inverse(odometry_pose(n - 1)) @ odometry_pose(n) if n else np.eye(4)
    estimate = replace(good_estimate(odometry_pose(n), motion), covariance=COVARIANCE)
    published = OdomFrame().update(stamped, estimate, {}, 0.0)
    return replace(
        published, state=state, epoch=epoch, T_odom_camera=T_BODY_CAMERA @ odometry_pose(n)
    )
