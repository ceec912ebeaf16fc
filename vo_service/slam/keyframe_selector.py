"""Keyframe selection by the distance of poses in steps of 15 cm or 10 degrees."""

import math

import numpy as np

from drivers.core.geometry import Array
from vo_service.types import OdometryUpdate, TrackingState

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
