"""How the camera moves: paths that know the exact pose of the colour eye at any instant.

The room's world is z up with its origin on the middle of the floor; the camera's axes are optical
(x right, y down, z forward). Built-in motions end where they began, so that they can be looped.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.geometry import Array
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.track import TrackPath

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


class Path(Protocol):
    """The exact motion of the colour eye."""

    def poses(self, times_s: Array) -> Array:
        """T_world_camera (N, 4, 4) at `times_s` (N,), counted from the first frame's stamp."""
        ...


def make_path(config: SyntheticConfig, room_height_m: float) -> Path:
    """The path that `config` asks for. Raises InputError if the track cannot be used."""
    if config.track is not None:
        return TrackPath.read(config.track, config, room_height_m)
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
