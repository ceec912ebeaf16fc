"""Recorded motion: a TUM trajectory becomes a smooth motion through the room."""

from pathlib import Path

import numpy as np

from drivers.core.errors import InputError
from drivers.core.geometry import Array, quaternion_from_rotation
from drivers.core.trajectory import Trajectory, read_trajectory
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motion.base import CameraMotion
from drivers.synthetic.motion.spline import CubicSpline

FLOOR_MARGIN_M = 0.4
CEILING_MARGIN_M = 0.4


class RecordedMotion(CameraMotion):
    """A recorded track, moved into the middle of the room but neither rotated nor scaled."""

    def __init__(
        self, trajectory: Trajectory, start_s: float, duration_s: float, loop: bool
    ) -> None:
        times_s = trajectory.stamps_s - trajectory.stamps_s[0]
        quaternions = np.array(
            [quaternion_from_rotation(T[:3, :3]) for T in trajectory.T_world_camera]
        )
        # q and -q are one rotation: choose signs so that neighbors are close.
        flips = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=1) + 1e-12)
        quaternions[1:] *= np.cumprod(flips)[:, None]
        positions = trajectory.T_world_camera[:, :3, 3]
        self._spline = CubicSpline(times_s, np.hstack([positions, quaternions]))
        self._start_s, self._duration_s, self._loop = start_s, duration_s, loop
        self._shift_m = np.zeros(3)

    @classmethod
    def read(cls, file: Path, config: SyntheticConfig, room_height_m: float) -> "RecordedMotion":
        """Read and place a track file.

        Raises:
            InputError: If it is broken or too short.
        """
        track = read_trajectory(file)
        available_s = float(track.stamps_s[-1] - track.stamps_s[0]) - config.track_start_s
        if len(track) < 2 or config.track_start_s < 0 or config.duration_s > available_s + 1e-6:
            raise InputError(
                f"{file}: has {available_s:.3f} s from track_start_s {config.track_start_s:g} on, "
                f"but duration_s is {config.duration_s:g}: set a shorter duration_s"
            )
        motion = cls(track, config.track_start_s, config.duration_s, config.loop)
        motion._center(room_height_m)
        return motion

    def poses(self, times_s: Array) -> Array:
        """See `CameraMotion`."""
        values = self._spline(self._start_s + self._playback_time(times_s))
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, 3] = values[:, :3] + self._shift_m
        T[:, :3, :3] = _rotations_from_quaternions(values[:, 3:])
        return T

    def _playback_time(self, times_s: Array) -> Array:
        """In a loop the track is played forward and back, slower at both ends."""
        if not self._loop:
            return times_s
        phase = 2 * np.pi * times_s / self._duration_s
        result: Array = 0.25 * self._duration_s * (1.0 - np.cos(phase))
        return result

    def _center(self, room_height_m: float) -> None:
        position_m = self.poses(np.linspace(0.0, self._duration_s, 500))[:, :3, 3]
        low, high = position_m.min(axis=0), position_m.max(axis=0)
        self._shift_m = -(low + high) / 2
        above_floor = max(0.0, FLOOR_MARGIN_M - low[2])
        below_ceiling = min(0.0, room_height_m - CEILING_MARGIN_M - high[2])
        self._shift_m[2] = above_floor + below_ceiling


def _rotations_from_quaternions(quaternions: Array) -> Array:
    """Convert quaternions (N, 4), x y z w of any length, to matrices (N, 3, 3)."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
