"""How far apart two views are, in steps: 15 cm or 10 degrees, whichever is more of them."""

import math

import numpy as np

from drivers.geometry import Array
from vo_service.types import PoseUpdate, TrackingState

STEP_M = 0.15
STEP_RAD = math.radians(10.0)


def steps_between(T_world_camera: Array, others: Array) -> Array:
    """Steps from one pose (4, 4) to others (..., 4, 4); shape (...)."""
    distance_m = np.linalg.norm(others[..., :3, 3] - T_world_camera[:3, 3], axis=-1)
    trace = (others[..., :3, :3] * T_world_camera[:3, :3]).sum(axis=(-2, -1))
    angle_rad = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    steps: Array = np.maximum(distance_m / STEP_M, angle_rad / STEP_RAD)
    return steps


class Gate:
    """Lets a frame through when it is tracked and some steps away from the last one let through.

    The first good frame of an epoch always is.
    """

    def __init__(self, steps: float = 1.0) -> None:
        self._steps = steps
        self._last: tuple[int, Array] | None = None  # epoch and pose

    def lets_through(self, update: PoseUpdate) -> bool:
        """Whether this frame is to be a keyframe."""
        last, T_world_camera = self._last, update.T_world_camera
        if update.state is not TrackingState.TRACKING:
            return False
        is_same_epoch = last is not None and last[0] == update.epoch
        if (
            last is not None
            and is_same_epoch
            and steps_between(T_world_camera, last[1]) < self._steps
        ):
            return False
        self._last = (update.epoch, T_world_camera)
        return True

    def forget(self) -> None:
        """Let the next good frame through. Safe from any thread."""
        self._last = None
