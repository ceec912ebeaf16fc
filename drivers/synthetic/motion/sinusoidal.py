"""Sums of sines: smooth motions that return to their start after a given time."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array

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
