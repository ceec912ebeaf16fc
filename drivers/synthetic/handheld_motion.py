"""Motions of a hand: a slow sweep, and a tremor of sinusoids."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from drivers.synthetic.camera_motion import CameraMotion, look_rotations, rotations_from_vectors

# (amplitude in meters or radians, frequency in Hz).
Sinusoids = tuple[tuple[float, float], ...]
TREMOR_POSITION: Sinusoids = ((0.006, 0.7), (0.004, 1.3), (0.0015, 2.9), (0.0006, 5.3))
TREMOR_ROTATION: Sinusoids = ((0.010, 0.8), (0.006, 1.7), (0.003, 3.1), (0.0012, 5.9))
# The tremor of a hand: x y z, and a rotation vector in the camera's axes.
TREMOR = (TREMOR_POSITION,) * 3 + (TREMOR_ROTATION,) * 3


@dataclass(frozen=True)
class SinusoidSum:
    """Six sums of K sines, each sine with a whole number of periods in the duration."""

    amplitude: Array  # (6, K)
    angular_frequency: Array
    phase: Array

    @classmethod
    def random(
        cls, rng: np.random.Generator, duration_s: float, axes: tuple[Sinusoids, ...]
    ) -> "SinusoidSum":
        """Make sines of random phase near the given frequencies.

        A frequency that is rounded up gets a smaller amplitude, so its speed does not grow.

        Args:
            rng: Generator of the phases.
            duration_s: Each sine has a whole number of periods in it.
            axes: The sines of each of the six axes.
        """
        longest = max(len(axis) for axis in axes)
        table = np.zeros((len(axes), longest, 2))
        for row, axis in zip(table, axes, strict=True):
            row[: len(axis)] = axis
        frequency = table[..., 1]
        periods = np.maximum(1.0, np.round(frequency * duration_s))
        scale = np.minimum(1.0, frequency * duration_s / periods)
        phase = rng.uniform(0.0, 2 * np.pi, frequency.shape)
        return cls(table[..., 0] * scale, 2 * np.pi * periods / duration_s, phase)

    def __call__(self, times_s: Array) -> Array:
        """Evaluate at `times_s` (N,); returns (N, 6)."""
        angle = times_s[:, None, None] * self.angular_frequency + self.phase
        result: Array = np.sum(self.amplitude * np.sin(angle), axis=2)
        return result


@dataclass(frozen=True)
class HandheldProfile:
    """The sweep of a handheld camera about a mean pose: x y z, yaw, pitch and roll."""

    sweep: tuple[Sinusoids, ...]
    camera_height_m: float
    pitch_down_rad: float


ROOM_SWEEP = HandheldProfile(
    (
        ((0.55, 0.05), (0.15, 0.15)),
        ((0.35, 0.10), (0.12, 0.20)),
        ((0.08, 0.10), (0.05, 0.25)),
        ((0.70, 0.05), (0.25, 0.15)),
        ((0.12, 0.10), (0.10, 0.20)),
        ((0.06, 0.15),),
    ),
    camera_height_m=1.50,
    pitch_down_rad=0.45,
)
# About as fast as freiburg1/floor: a quarter of a meter and 15 degrees per second.
FLOOR_SWEEP = HandheldProfile(
    (
        ((0.60, 0.05), (0.20, 0.15)),
        ((0.40, 0.10), (0.12, 0.20)),
        ((0.08, 0.10), (0.04, 0.25)),
        ((0.50, 0.05), (0.20, 0.15)),
        ((0.08, 0.10), (0.04, 0.20)),
        ((0.08, 0.15),),
    ),
    camera_height_m=1.15,
    pitch_down_rad=1.25,
)


class HandheldMotion(CameraMotion):
    """A sweep about the middle of the room, with the tremor of a hand."""

    def __init__(
        self,
        rng: np.random.Generator,
        duration_s: float,
        profile: HandheldProfile,
        sweep_scale: float = 1.0,
        tremor_scale: float = 1.0,
    ) -> None:
        self._sweep = SinusoidSum.random(rng, duration_s, profile.sweep)
        self._tremor = SinusoidSum.random(rng, duration_s, TREMOR)
        self._profile = profile
        self._sweep_scale, self._tremor_scale = sweep_scale, tremor_scale

    def poses(self, times_s: Array) -> Array:
        """See `CameraMotion`."""
        sweep = self._sweep_scale * self._sweep(times_s)
        tremor = self._tremor_scale * self._tremor(times_s)
        height_m, down_rad = self._profile.camera_height_m, self._profile.pitch_down_rad
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, 3] = np.array([0.0, 0.0, height_m]) + sweep[:, :3] + tremor[:, :3]
        T[:, :3, :3] = look_rotations(sweep[:, 3], sweep[:, 4] + down_rad, sweep[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(tremor[:, 3:])
        return T


# A little more than a Kinect's field of view, as tangents, and the fractions of each ray to check.
VIEW_TAN_X, VIEW_TAN_Y = np.linspace(-0.7, 0.7, 5), np.linspace(-0.52, 0.52, 5)
RAY_FRACTIONS = np.array([0.25, 0.5, 0.75, 1.0])
MAX_UP_SLOPE = -0.2
# Looks up from the floor into the room: angle and period.
LOOK_UP_RAD = 0.65
LOOK_UP_PERIOD_S = 10.0


class FloorMotion(CameraMotion):
    """A handheld camera over the bare floor: most views show one plane."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._handheld = HandheldMotion(rng, duration_s, FLOOR_SWEEP)
        self._duration_s = duration_s

    def poses(self, times_s: Array) -> Array:
        """See `CameraMotion`."""
        looks = round(self._duration_s / LOOK_UP_PERIOD_S)
        # It begins and ends at the floor; looking up takes a fifth of the period.
        up = LOOK_UP_RAD * np.sin(np.pi * looks * times_s / self._duration_s) ** 12
        T = self._handheld.poses(times_s)
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(
            up[:, None] * np.array([1.0, 0.0, 0.0])
        )
        return T

    def clearance_points_m(self, times_s: Array) -> Array:
        """Points (M, 3) between the camera and the floor that it sees when it does not look up."""
        T = self._handheld.poses(times_s)
        x, y = (grid.ravel() for grid in np.meshgrid(VIEW_TAN_X, VIEW_TAN_Y))
        rays = np.stack([x, y, np.ones_like(x)], axis=1) @ T[:, :3, :3].transpose(0, 2, 1)
        to_floor = -T[:, None, 2, 3] / np.minimum(rays[..., 2], MAX_UP_SLOPE)
        steps = to_floor[..., None, None] * RAY_FRACTIONS[:, None] * rays[..., None, :]
        result: Array = (T[:, None, None, :3, 3] + steps).reshape(-1, 3)
        return result
