"""Prediction of the camera's motion at constant velocity."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, rigid_transform, so3_exp, so3_log

# The velocity is the mean over this many motions: one alone is noisy, more are out of date.
MAX_MOTIONS = 3
# Longest time between two good frames that gives a velocity, and longest time of a prediction.
MAX_STEP_S = 0.2
# A camera on a robot or in a hand is not faster; larger velocities are clipped.
MAX_SPEED_M_S, MAX_TURN_RATE_RAD_S = 2.0, 4.0
# Error of the prediction as an angle at the camera: at once, and by an unknown acceleration (of a
# hand: 5 rad/s^2 in rotation, and 10 m/s^2 for points 2 m away).
MIN_SPREAD_RAD, ACCELERATION_RAD_S2 = 0.04, 10.0


@dataclass(frozen=True)
class MotionPrediction:
    """A predicted motion.

    Attributes:
        T_reference_camera: 4x4.
        spread_rad: Angle by which the direction to a point may differ from the predicted one.
    """

    T_reference_camera: Array
    spread_rad: float


class ConstantVelocityModel:
    """Motion model of constant velocity, from the last good motions."""

    def __init__(self) -> None:
        self._stamp_s = -np.inf
        self._steps: deque[tuple[Array, float]] = deque(maxlen=MAX_MOTIONS)

    def reset(self, stamp_s: float) -> None:
        """Start a chain of frames with unknown velocity."""
        self._stamp_s = stamp_s
        self._steps.clear()

    def add(self, T_reference_camera: Array, stamp_s: float) -> None:
        """Add a motion since the last good frame. A stamp that does not increase resets it."""
        duration_s = stamp_s - self._stamp_s
        self._stamp_s = stamp_s
        if 0.0 < duration_s <= MAX_STEP_S:
            self._steps.append((T_reference_camera, duration_s))
        else:
            self._steps.clear()

    def predict(self, stamp_s: float) -> MotionPrediction | None:
        """Predict the motion from the last good frame to a stamp; None if it is unknown."""
        ahead_s = stamp_s - self._stamp_s
        if not self._steps or not 0.0 < ahead_s <= MAX_STEP_S:
            return None
        velocity_m_s, velocity_rad_s = self._velocity()
        R = so3_exp(velocity_rad_s * ahead_s)
        return MotionPrediction(
            T_reference_camera=rigid_transform(R, velocity_m_s * ahead_s),
            spread_rad=MIN_SPREAD_RAD + 0.5 * ACCELERATION_RAD_S2 * ahead_s**2,
        )

    def _velocity(self) -> tuple[Array, Array]:
        """(3,) m/s and (3,) rad/s in the axes of the last good camera."""
        T_first_last = np.eye(4)
        duration_s = 0.0
        for T_reference_camera, step_s in self._steps:
            T_first_last = T_first_last @ T_reference_camera
            duration_s += step_s
        R, t = T_first_last[:3, :3], T_first_last[:3, 3]
        return (
            _limit_norm(R.T @ t / duration_s, MAX_SPEED_M_S),
            _limit_norm(so3_log(R) / duration_s, MAX_TURN_RATE_RAD_S),
        )


def _limit_norm(vector: Array, max_norm: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector if length <= max_norm else vector * (max_norm / length)
