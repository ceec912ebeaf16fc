"""What the odometry has said since the last place: the motion, how sure it is, how long."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, so3_log
from vo_service.odometry.covariance_accumulator import CovarianceAccumulator
from vo_service.slam.keyframe_selector import KeyframeSelector
from vo_service.types import OdometryUpdate

# From one place to the next, in steps of 15 cm or 10 degrees.
MIN_KEYFRAME_STEPS = 2.0
# Two frames further apart in time say nothing of the velocity.
MAX_VELOCITY_INTERVAL_S = 0.2


@dataclass(frozen=True)
class OdometryConstraint:
    """From one place to the next.

    velocity    (6,) twist of the camera in its own axes at the end, m/s and rad/s
    covariance  6x6 of the motion, as a small motion in the camera's axes
    length_m    how far the camera has travelled
    """

    velocity: Array
    covariance: Array
    length_m: float


class ConstraintAccumulator:
    """Sees every result of the odometry, and says which frames are to be places."""

    def __init__(self) -> None:
        self._keyframe_selector = KeyframeSelector(MIN_KEYFRAME_STEPS)
        self._covariance = CovarianceAccumulator()
        self._length_m = 0.0
        self._last: tuple[int, float, Array] | None = None  # epoch, stamp and pose

    def update(self, update: OdometryUpdate) -> OdometryConstraint | None:
        """The hop that ends with this frame, if it is to be a place."""
        if not update.estimate.ok:
            return None
        velocity = self._accumulate(update)
        if not self._keyframe_selector.accepts(update):
            return None
        hop = OdometryConstraint(velocity, self._covariance.pose, self._length_m)
        self._covariance.reset()
        self._length_m = 0.0
        return hop

    def force_keyframe(self) -> None:
        """Let the next good frame be a place. Safe from any thread."""
        self._keyframe_selector.reset()

    def _accumulate(self, update: OdometryUpdate) -> Array:
        """Go on to the next good frame; the velocity there."""
        epoch, stamp_s, T_world_camera = update.epoch, update.frame.stamp_s, update.T_world_camera
        last, self._last = self._last, (epoch, stamp_s, T_world_camera)
        if last is None or last[0] != epoch:
            self._covariance.reset()
            self._length_m = 0.0
            return np.zeros(6)
        T_last_camera = inverse(last[2]) @ T_world_camera
        self._covariance.add(update.estimate, T_last_camera)
        self._length_m += float(np.linalg.norm(T_last_camera[:3, 3]))
        duration_s = stamp_s - last[1]
        if not 0.0 < duration_s <= MAX_VELOCITY_INTERVAL_S:
            return np.zeros(6)
        step = [-inverse(T_last_camera)[:3, 3], so3_log(T_last_camera[:3, :3])]
        return np.concatenate(step) / duration_s


class NullConstraintAccumulator:
    """Where no place is remembered."""

    def update(self, update: OdometryUpdate) -> None:
        """Never."""

    def force_keyframe(self) -> None:
        """Nothing is known."""
