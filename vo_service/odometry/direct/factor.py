"""The factor of a point: its residuals in a frame, their weights, and their derivatives.

A point of a keyframe with brightness I_k and position x has two residuals in a frame:

    r_I = I - a I_k        brightness, gray levels; a is the gain
    r_D = w - w(x)         inverse depth, 1/m, as seen from the keyframe

Both follow Student's t with the variances sigma_I^2 + v (v is that of the interpolation) and
sigma_D^2: Kerl, Sturm and Cremers, "Robust Odometry Estimation for RGB-D Cameras" (ICRA 2013). The
derivatives are those of the keyframe (inverse compositional): Baker and Matthews, "Lucas-Kanade 20
Years On" (IJCV 56, 2004), Section 3.2.
"""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel
from vo_service.odometry.direct.parameters import DEGREES_OF_FREEDOM

# Derivatives of a residual by a small motion of the keyframe's points.
Jacobian = tuple[float, float, float, float, float, float]


@inline_kernel
def brightness_residual(brightness: float, keyframe_brightness: float, gain: float) -> float:
    """Residual r_I of a point in a frame, gray levels.

    Args:
        brightness: I, in the frame.
        keyframe_brightness: I_k, in the keyframe.
        gain: a, of the frame's brightness relative to the keyframe's.
    """
    return brightness - gain * keyframe_brightness


@inline_kernel
def student_weight(residual: float, variance: float) -> float:
    """Weight of a residual in the fit: that of Student's t over its variance."""
    # A division takes as long as all the rest.
    return (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM * variance + residual * residual)


@inline_kernel
def student_negative_log(squared: float) -> float:
    """Negative logarithm of Student's t, up to a constant, of a squared residual in variances."""
    return float(0.5 * (DEGREES_OF_FREEDOM + 1.0) * np.log(1.0 + squared / DEGREES_OF_FREEDOM))


@inline_kernel
def jacobian(position_m: Array, gradient: Array, n: int, scale: float) -> Jacobian:
    """Scale times (p, x cross p) of the derivative p by the position x of point n.

    As a tuple it is kept in registers.

    Args:
        position_m: (3, N) of a keyframe's points.
        gradient: (3, N) their derivatives.
        n: Index of the point.
        scale: Of the derivative.
    """
    x, y, z = position_m[0, n], position_m[1, n], position_m[2, n]
    px, py, pz = scale * gradient[0, n], scale * gradient[1, n], scale * gradient[2, n]
    return px, py, pz, y * pz - z * py, z * px - x * pz, x * py - y * px
