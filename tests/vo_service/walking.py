"""A pose tracker that is walked about."""

import numpy as np

from drivers.geometry import (
    R_BODY_OPTICAL,
    Array,
    rigid_transform,
    rotation_from_vector,
)
from tests.vo_service.fakes import frame, good
from vo_service.pose_tracker import PoseTracker, StampedFrame
from vo_service.types import Estimate, PoseUpdate

RATE_HZ = 30.0
AHEAD = rigid_transform(R_BODY_OPTICAL, [0.3, 0.0, 0.0])  # 30 cm before the base, straight ahead
AWRY = rigid_transform(R_BODY_OPTICAL @ rotation_from_vector([0.3, -0.2, 0.5]), [0.2, -0.1, 0.4])


def motion(forward_m: float = 0.0, right_m: float = 0.0, down_m: float = 0.0) -> Array:
    """A step of the camera along its own axes."""
    return rigid_transform(np.eye(3), [right_m, down_m, forward_m])


def turn(pitch: float = 0.0, yaw_right: float = 0.0, roll: float = 0.0) -> Array:
    """A turn of the camera about its own x, y and z."""
    return rigid_transform(rotation_from_vector([pitch, yaw_right, roll]), np.zeros(3))


def update(tracker: PoseTracker, estimate: Estimate, seq: int = 0) -> PoseUpdate:
    stamped = StampedFrame(frame(seq, seq / RATE_HZ), 1e9 + seq / RATE_HZ)
    return tracker.update(stamped, estimate, {"surf": 4.0}, 0.01)


def walk(tracker: PoseTracker, steps: list[Array]) -> list[PoseUpdate]:
    """Updates of a start and one more a step."""
    T = np.eye(4)
    updates = [update(tracker, good(T))]
    for seq, step in enumerate(steps, 1):
        T = T @ step
        updates.append(update(tracker, good(T, step), seq))
    return updates


def sigmas(update: PoseUpdate) -> Array:
    deviations: Array = np.sqrt(np.diag(update.pose_covariance))
    return deviations
