"""How a motion begins and ends without a jerk: functions of the part of it that is over, 0 to 1."""

import numpy as np

from drivers.core.geometry import Array


def cosine_ramp(part: Array) -> Array:
    """From 0 to 1 while `part` goes from 0 to 1, fastest in the middle."""
    result: Array = 0.5 - 0.5 * np.cos(np.pi * np.clip(part, 0.0, 1.0))
    return result


def smootherstep(part: Array) -> Array:
    """As `ramp`, without a jump in the acceleration."""
    x = np.clip(part, 0.0, 1.0)
    result: Array = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return result


def smootherstep_integral(part: Array) -> Array:
    """The area under `eased`, from far before 0 up to `part`."""
    x = np.clip(part, 0.0, 1.0)
    result: Array = x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(part - 1.0, 0.0)
    return result
