"""Camera motions by name; here also those by a script and those along a recorded track."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import (
    Array,
    Trajectory,
    quaternion_from_rotation,
    read_trajectory,
    so3_exp,
)
from drivers.synthetic.camera_motion import (
    CameraMotion,
    CubicSpline,
    cosine_ramp,
    make_poses,
    smootherstep,
)
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.driven_motion import DrivenMotion
from drivers.synthetic.human_motion import (
    ROOM_SWEEP,
    FloorMotion,
    HandheldMotion,
    HandheldProfile,
    OrbitMotion,
    TourMotion,
)

TOWARD_WALL_M = 0.5
LOOK_ASIDE_RAD = 1.15
WALL_VIEW_PERIOD_S = 10.0
# A robot that drives back and forth.
ROBOT_CAMERA_HEIGHT_M = 1.3
DRIVE_M, DRIVE_SPEED_M_S = 0.6, 0.3
# Each period has a turn away and a turn back, half a second each. The angles alternate between
# periods. Halfway through a turn the rate is pi times the angle: 2.5 and 3.8 radians per second.
TURN_PAIR_PERIOD_S = 6.0
TURN_S = 0.5
TURN_ANGLES_RAD = (0.8, 1.2)
CREEP_SPEED_M_S = 0.001


def yaw_from_wall(times_s: Array, duration_s: float) -> Array:
    """Angle (N,) to the wall at +y, rad: zero for a third of each period."""
    period_s = duration_s / max(1, round(duration_s / WALL_VIEW_PERIOD_S))
    phase = 0.5 - 0.5 * np.cos(2 * np.pi * times_s / period_s)
    return LOOK_ASIDE_RAD * (1.0 - smootherstep(2.0 * phase - 0.5))


def fast_turns(times_s: Array, duration_s: float) -> Array:
    """Angle (N,) of fast turns away and back, rad."""
    pairs = max(1, round(duration_s / TURN_PAIR_PERIOD_S))
    period_s = duration_s / pairs
    yaw_rad = np.zeros_like(times_s)
    for pair in range(pairs):
        since_s = times_s - pair * period_s
        away = cosine_ramp((since_s - 0.25 * period_s) / TURN_S)
        back = cosine_ramp((since_s - 0.75 * period_s) / TURN_S)
        yaw_rad += TURN_ANGLES_RAD[pair % len(TURN_ANGLES_RAD)] * (away - back)
    return yaw_rad


# A hand that holds the camera level, two meters from the wall at +y: it faces aside, then for a
# third of the time the wall, then aside again.
LEVEL_AT_WALL = HandheldProfile(
    (
        ((0.15, 0.10), (0.06, 0.20)),
        ((0.08, 0.10),),
        ((0.06, 0.10), (0.03, 0.25)),
        ((0.08, 0.10), (0.04, 0.20)),
        ((0.04, 0.10),),
        ((0.04, 0.15),),
    ),
    camera_height_m=1.45,
    pitch_down_rad=0.0,
    turn_rad=yaw_from_wall,
    forward_m=TOWARD_WALL_M,
)


class WallDriveMotion(CameraMotion):
    """A robot that drives back and forth along the wall at +y; its level camera turns to it."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._duration_s = duration_s
        self._start_rad = rng.uniform(-np.pi, np.pi)
        drives = max(1, round(DRIVE_SPEED_M_S / DRIVE_M * duration_s / (2 * np.pi)))
        self._rate_rad_s = 2 * np.pi * drives / duration_s

    def poses(self, times_s: Array) -> Array:
        zero = np.zeros_like(times_s)
        along_m = DRIVE_M * np.sin(self._rate_rad_s * times_s + self._start_rad)
        eye_m = np.column_stack([along_m, zero + TOWARD_WALL_M, zero + ROBOT_CAMERA_HEIGHT_M])
        return make_poses(eye_m, yaw_from_wall(times_s, self._duration_s), zero, zero)


class CreepMotion(CameraMotion):
    """Straight on at a millimeter per second, without tremor; and back, if it is looped."""

    def __init__(self, rng: np.random.Generator, round_trip_s: float) -> None:
        """`round_trip_s` is infinite if the camera never comes back."""
        yaw_rad, sideways_rad = rng.uniform(-np.pi, np.pi, 2)
        eye_m = np.array([[0.0, 0.0, ROOM_SWEEP.camera_height_m]])
        down_rad = np.array([ROOM_SWEEP.pitch_down_rad])
        (self._T_start,) = make_poses(eye_m, np.array([yaw_rad]), down_rad, np.zeros(1))
        self._direction = so3_exp([0.0, 0.0, sideways_rad])[:2, 0]
        self._round_trip_s = round_trip_s

    def poses(self, times_s: Array) -> Array:
        along_m = CREEP_SPEED_M_S * np.minimum(times_s, self._round_trip_s - times_s)
        T = np.tile(self._T_start, (len(times_s), 1, 1))
        T[:, :2, 3] = along_m[:, None] * self._direction
        return T


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

        Args:
            config: Start in the track, duration and loop.

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
        return 0.25 * self._duration_s * (1.0 - np.cos(phase))

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


def _held(**changes: Any) -> Callable[[np.random.Generator, float], CameraMotion]:
    return partial(HandheldMotion, profile=replace(ROOM_SWEEP, **changes))


def make_motion(config: SyntheticConfig, room_height_m: float) -> CameraMotion:
    """Make the motion of `config`. Raises InputError."""
    if config.track is not None:
        return RecordedMotion.read(config.track, config, room_height_m)
    rng, duration_s = np.random.default_rng([config.seed, 1]), config.duration_s
    if config.motion is MotionKind.DRIVEN:
        return DrivenMotion(config)
    if config.motion is MotionKind.CREEP:
        return CreepMotion(rng, duration_s if config.loop else np.inf)
    return MOTIONS[config.motion](rng, duration_s)


MOTIONS: dict[MotionKind, Callable[[np.random.Generator, float], CameraMotion]] = {
    MotionKind.HAND_HELD: HandheldMotion,
    MotionKind.SMOOTH: _held(tremor_scale=0.0),
    MotionKind.STILL: _held(sweep_scale=0.0, tremor_scale=0.0),
    MotionKind.FAST_TURN: _held(sweep_scale=0.5, turn_rad=fast_turns),
    MotionKind.WALL: partial(HandheldMotion, profile=LEVEL_AT_WALL),
    MotionKind.WALL_DRIVE: WallDriveMotion,
    MotionKind.FLOOR: FloorMotion,
    MotionKind.ORBIT: OrbitMotion,
    MotionKind.TOUR: TourMotion,
}
