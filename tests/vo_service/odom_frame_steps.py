"""A pose tracker that is walked about."""

import numpy as np

from drivers.core.geometry import R_BODY_OPTICAL, Array, rigid_transform, so3_exp
from tests.vo_service.fakes import good_estimate, make_frame
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate

RATE_HZ = 30.0
T_BASE_CAMERA_AHEAD = rigid_transform(
    R_BODY_OPTICAL, [0.3, 0.0, 0.0]
)  # 30 cm before the base, straight ahead
T_BASE_CAMERA_TILTED = rigid_transform(R_BODY_OPTICAL @ so3_exp([0.3, -0.2, 0.5]), [0.2, -0.1, 0.4])


def translation_step(forward_m: float = 0.0, right_m: float = 0.0, down_m: float = 0.0) -> Array:
    """A step of the camera along its own axes."""
    return rigid_transform(np.eye(3), [right_m, down_m, forward_m])


def rotation_step(pitch: float = 0.0, yaw_right: float = 0.0, roll: float = 0.0) -> Array:
    """A turn of the camera about its own x, y and z."""
    return rigid_transform(so3_exp([pitch, yaw_right, roll]), np.zeros(3))


def update_frame(tracker: OdomFrame, estimate: Estimate, seq: int = 0) -> OdometryUpdate:
    stamped = StampedFrame(make_frame(seq, seq / RATE_HZ), 1e9 + seq / RATE_HZ)
    return tracker.update(stamped, estimate, {"surf": 4.0}, 0.01)


def run_steps(tracker: OdomFrame, steps: list[Array]) -> list[OdometryUpdate]:
    """Updates of a start and one more a step."""
    T = np.eye(4)
    updates = [update_frame(tracker, good_estimate(T))]
    for seq, step in enumerate(steps, 1):
        T = T @ step
        updates.append(update_frame(tracker, good_estimate(T, step), seq))
    return updates


def pose_sigmas(update: OdometryUpdate) -> Array:
    deviations: Array = np.sqrt(np.diag(update.pose_covariance))
    return deviations
