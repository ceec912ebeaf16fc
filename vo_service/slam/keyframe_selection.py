"""The selection of keyframes, and the odometry constraint from one to the next."""

import math
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, so3_log
from vo_service.odometry.uncertainty import CovarianceAccumulator
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

STEP_M = 0.15
STEP_RAD = math.radians(10.0)


def pose_distance_steps(T_world_camera: Array, others: Array) -> Array:
    """Steps (...) from a pose (4, 4) to others (..., 4, 4): the larger of distance and angle."""
    distance_m = np.linalg.norm(others[..., :3, 3] - T_world_camera[:3, 3], axis=-1)
    trace = (others[..., :3, :3] * T_world_camera[:3, :3]).sum(axis=(-2, -1))
    angle_rad = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    steps: Array = np.maximum(distance_m / STEP_M, angle_rad / STEP_RAD)
    return steps


class KeyframeSelector:
    """Select tracked frames that are some steps away from the last selected one.

    The first good frame of an epoch is always selected.

    Args:
        min_steps: Smallest distance from the last selected frame.
    """

    def __init__(self, min_steps: float = 1.0) -> None:
        self._min_steps = min_steps
        self._last_accepted: tuple[int, Array] | None = None  # epoch and pose

    def accepts(self, update: OdometryUpdate) -> bool:
        """Whether this frame becomes a keyframe."""
        last, T_world_camera = self._last_accepted, update.T_world_camera
        if update.state is not TrackingState.TRACKING:
            return False
        is_same_epoch = last is not None and last[0] == update.epoch
        if (
            last is not None
            and is_same_epoch
            and pose_distance_steps(T_world_camera, last[1]) < self._min_steps
        ):
            return False
        self._last_accepted = (update.epoch, T_world_camera)
        return True

    def reset(self) -> None:
        """Select the next good frame. May be called from any thread."""
        self._last_accepted = None


# Distance of two keyframes, in steps of 15 cm or 10 degrees.
MIN_KEYFRAME_STEPS = 2.0
# Longest time between two frames that gives a velocity.
MAX_VELOCITY_INTERVAL_S = 0.2


@dataclass(frozen=True)
class OdometryConstraint:
    """Motion from one keyframe to the next.

    Attributes:
        velocity: (6,) twist of the camera in its own axes at the end, m/s and rad/s.
        covariance: 6x6 of the motion, as a small motion in the camera's axes.
        length_m: Length of the camera's path.
    """

    velocity: Array
    covariance: Array
    length_m: float


class ConstraintAccumulator:
    """Accumulate the odometry between keyframes, and select these."""

    def __init__(self) -> None:
        self._keyframe_selector = KeyframeSelector(MIN_KEYFRAME_STEPS)
        self._covariance = CovarianceAccumulator()
        self._length_m = 0.0
        self._last: tuple[int, float, Array] | None = None  # epoch, stamp and pose
        # Of the last frame: the motion since the one before, and its time, s; None = unknown.
        self._step: tuple[Array, float] | None = None

    def update(self, update: OdometryUpdate) -> OdometryConstraint | None:
        """Add a result; return the constraint if the frame becomes a keyframe."""
        if not update.estimate.ok:
            return None
        self._accumulate(update)
        if not self._keyframe_selector.accepts(update):
            return None
        constraint = OdometryConstraint(self._velocity(), self._covariance.pose, self._length_m)
        self._covariance.reset()
        self._length_m = 0.0
        return constraint

    def force_keyframe(self) -> None:
        """Make the next good frame a keyframe. May be called from any thread."""
        self._keyframe_selector.reset()

    def _accumulate(self, update: OdometryUpdate) -> None:
        """Add a good frame."""
        epoch, stamp_s, T_world_camera = update.epoch, update.frame.stamp_s, update.T_world_camera
        last, self._last = self._last, (epoch, stamp_s, T_world_camera)
        self._step = None
        if last is None or last[0] != epoch:
            self._covariance.reset()
            self._length_m = 0.0
            return
        T_last_camera = inverse(last[2]) @ T_world_camera
        self._covariance.add(update.estimate, T_last_camera)
        self._length_m += float(np.linalg.norm(T_last_camera[:3, 3]))
        self._step = T_last_camera, stamp_s - last[1]

    def _velocity(self) -> Array:
        """Velocity (6,) at the last frame, 0 if it is unknown."""
        if self._step is None:
            return np.zeros(6)
        T_last_camera, duration_s = self._step
        if not 0.0 < duration_s <= MAX_VELOCITY_INTERVAL_S:
            return np.zeros(6)
        step = [-inverse(T_last_camera)[:3, 3], so3_log(T_last_camera[:3, :3])]
        return np.concatenate(step) / duration_s


class NullConstraintAccumulator:
    """Accumulator without loop closure: no frame becomes a keyframe of the map."""

    def update(self, update: OdometryUpdate) -> None:
        """Return None."""

    def force_keyframe(self) -> None:
        """Do nothing."""
