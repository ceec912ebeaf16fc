"""Easing functions: smooth starts and ends of a motion whose progress goes from 0 to 1."""

import numpy as np

from drivers.core.geometry import Array


def cosine_ramp(progress: Array) -> Array:
    """Ramp from 0 to 1 while `progress` goes from 0 to 1, fastest in the middle."""
    result: Array = 0.5 - 0.5 * np.cos(np.pi * np.clip(progress, 0.0, 1.0))
    return result


def smootherstep(progress: Array) -> Array:
    """Ramp as `cosine_ramp`, without a jump in the acceleration."""
    x = np.clip(progress, 0.0, 1.0)
    result: Array = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return result


def smootherstep_integral(progress: Array) -> Array:
    """Integral of `smootherstep` from far below 0 up to `progress`."""
    x = np.clip(progress, 0.0, 1.0)
    result: Array = x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(progress - 1.0, 0.0)
    return result
