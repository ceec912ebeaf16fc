"""How the camera moves: paths that know the exact pose of the colour eye at any instant.

The room's world is z up with its origin on the middle of the floor; the camera's axes are optical
(x right, y down, z forward). Built-in motions end where they began, so that they can be looped.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.errors import InputError
from drivers.geometry import Array, quaternion_from_rotation
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.spline import CubicSpline
from drivers.trajectory import StampedPoses, read_trajectory

# (amplitude, frequency in Hz) of the sweep and of a hand's tremor, metres and radians.
Waves = tuple[tuple[float, float], ...]
SWEEP: tuple[Waves, ...] = (
    ((0.55, 0.05), (0.15, 0.15)),  # x
    ((0.35, 0.10), (0.12, 0.20)),  # y
    ((0.08, 0.10), (0.05, 0.25)),  # z
    ((0.70, 0.05), (0.25, 0.15)),  # yaw
    ((0.12, 0.10), (0.10, 0.20)),  # pitch
    ((0.06, 0.15),),  # roll
)
TREMOR_POSITION: Waves = ((0.006, 0.7), (0.004, 1.3), (0.0015, 2.9), (0.0006, 5.3))
TREMOR_ROTATION: Waves = ((0.010, 0.8), (0.006, 1.7), (0.003, 3.1), (0.0012, 5.9))
EYE_HEIGHT_M = 1.50
LOOK_DOWN_RAD = 0.45
FLOOR_MARGIN_M = 0.4
CEILING_MARGIN_M = 0.4


class Path(Protocol):
    """The exact motion of the colour eye."""

    def poses(self, times_s: Array) -> Array:
        """T_world_camera (N, 4, 4) at `times_s` (N,), counted from the first frame's stamp."""
        ...


def make_path(config: SyntheticConfig, room_height_m: float) -> Path:
    """The path that `config` asks for. Raises InputError if the track cannot be used."""
    if config.track is not None:
        return TrackPath.read(config, room_height_m)
    rng = np.random.default_rng([config.seed, 1])
    sweep = WavePath.random(rng, config.duration_s, SWEEP)
    tremor = WavePath.random(
        rng, config.duration_s, (TREMOR_POSITION,) * 3 + (TREMOR_ROTATION,) * 3
    )
    moving = {Motion.HAND_HELD: (1.0, 1.0), Motion.SMOOTH: (1.0, 0.0), Motion.STILL: (0.0, 0.0)}
    scale = moving[config.motion]
    return HandPath(sweep, tremor, *scale)


@dataclass(frozen=True)
class WavePath:
    """Six sums of sines (..., 6), each with a whole number of periods in `duration_s`."""

    amplitude: Array  # (6, K)
    angular_frequency: Array
    phase: Array

    @classmethod
    def random(
        cls, rng: np.random.Generator, duration_s: float, axes: tuple[Waves, ...]
    ) -> "WavePath":
        """Waves of random phase near the frequencies asked; never faster for being rounded up."""
        longest = max(len(axis) for axis in axes)
        table = np.zeros((len(axes), longest, 2))
        for row, axis in zip(table, axes, strict=True):
            row[: len(axis)] = axis
        frequency = table[..., 1]
        periods = np.maximum(1.0, np.round(frequency * duration_s))
        slower = np.minimum(1.0, frequency * duration_s / periods)
        phase = rng.uniform(0.0, 2 * np.pi, frequency.shape)
        return cls(table[..., 0] * slower, 2 * np.pi * periods / duration_s, phase)

    def __call__(self, times_s: Array) -> Array:
        """Values (N, 6)."""
        angle = times_s[:, None, None] * self.angular_frequency + self.phase
        result: Array = np.sum(self.amplitude * np.sin(angle), axis=2)
        return result


@dataclass(frozen=True)
class HandPath:
    """A sweep over the middle of the room with the tremor of the hand that holds the camera."""

    sweep: WavePath
    tremor: WavePath
    sweep_scale: float
    tremor_scale: float

    def poses(self, times_s: Array) -> Array:
        """See `Path.poses`."""
        sweep = self.sweep_scale * self.sweep(times_s)
        tremor = self.tremor_scale * self.tremor(times_s)
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, 3] = np.array([0.0, 0.0, EYE_HEIGHT_M]) + sweep[:, :3] + tremor[:, :3]
        T[:, :3, :3] = _look(sweep[:, 3], sweep[:, 4] + LOOK_DOWN_RAD, sweep[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ _rotations(tremor[:, 3:])
        return T


class TrackPath:
    """A recorded track, moved into the middle of the room but neither turned nor scaled."""

    def __init__(self, track: StampedPoses, start_s: float, duration_s: float, loop: bool) -> None:
        times_s = track.stamps_s - track.stamps_s[0]
        quaternions = np.array([quaternion_from_rotation(T[:3, :3]) for T in track.T_world_camera])
        # q and -q are one rotation: choose signs so that neighbours are close.
        flips = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=1) + 1e-12)
        quaternions[1:] *= np.cumprod(flips)[:, None]
        positions = track.T_world_camera[:, :3, 3]
        self._spline = CubicSpline(times_s, np.hstack([positions, quaternions]))
        self._start_s, self._duration_s, self._loop = start_s, duration_s, loop
        self._shift_m = np.zeros(3)

    @classmethod
    def read(cls, config: SyntheticConfig, room_height_m: float) -> "TrackPath":
        """Read and place the track of `config`; InputError if it is too short."""
        assert config.track is not None
        track = read_trajectory(config.track)
        available_s = float(track.stamps_s[-1] - track.stamps_s[0]) - config.track_start_s
        if len(track) < 2 or config.track_start_s < 0 or config.duration_s > available_s + 1e-6:
            raise InputError(
                f"{config.track}: holds {available_s:.3f} s from its start at "
                f"{config.track_start_s:g} s where duration_s is {config.duration_s:g}: "
                "ask for a shorter duration"
            )
        path = cls(track, config.track_start_s, config.duration_s, config.loop)
        path._centre(room_height_m)
        return path

    def poses(self, times_s: Array) -> Array:
        """See `Path.poses`."""
        values = self._spline(self._start_s + self._track_time(times_s))
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, 3] = values[:, :3] + self._shift_m
        T[:, :3, :3] = _rotations_from_quaternions(values[:, 3:])
        return T

    def _track_time(self, times_s: Array) -> Array:
        """In a loop the track is played there and back, slowing down at both ends."""
        if not self._loop:
            return times_s
        phase = 2 * np.pi * times_s / self._duration_s
        result: Array = 0.25 * self._duration_s * (1.0 - np.cos(phase))
        return result

    def _centre(self, room_height_m: float) -> None:
        position_m = self.poses(np.linspace(0.0, self._duration_s, 500))[:, :3, 3]
        low, high = position_m.min(axis=0), position_m.max(axis=0)
        self._shift_m = -(low + high) / 2
        above_floor = max(0.0, FLOOR_MARGIN_M - low[2])
        below_ceiling = min(0.0, room_height_m - CEILING_MARGIN_M - high[2])
        self._shift_m[2] = above_floor + below_ceiling


def _look(yaw: Array, down: Array, roll: Array) -> Array:
    """Rotations (N, 3, 3) of a camera looking along +y, turned left by yaw, down and rolled."""
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    zero = np.zeros_like(yaw)
    turn = _rotations(np.stack([zero, zero, yaw], axis=1))
    nod = _rotations(np.stack([-down, zero, zero], axis=1))
    tilt = _rotations(np.stack([zero, zero, roll], axis=1))
    result: Array = turn @ level @ nod @ tilt
    return result


def _rotations(vectors_rad: Array) -> Array:
    """Rodrigues' formula for many vectors: (N, 3) to (N, 3, 3)."""
    x, y, z = vectors_rad.T
    zero = np.zeros_like(x)
    K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    angle = np.linalg.norm(vectors_rad, axis=1)[:, None, None]
    sine, cosine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    result: Array = np.eye(3) + sine * K + cosine * (K @ K)
    return result


def _rotations_from_quaternions(quaternions: Array) -> Array:
    """(N, 4) x y z w of any length to (N, 3, 3)."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
