"""Noise of a feature's 3-D point, across the viewing ray and along it.

The sensor measures disparity, so the error of 1/z is about constant and that of z grows with z^2
(Khoshelham and Elberink, Sensors 12, 2012, eq. 10).
"""

from drivers.core.geometry import Array

# Standard deviation of 1/z of one pixel, in 1/m. The Kinect reports disparity in steps of 1/8
# pixel, which at a baseline of 75 mm and a focal length of 580 pixels is 2.9e-3 1/m; the noise is
# about half a step.
INVERSE_DEPTH_SIGMA_PER_M = 1.4e-3

# Standard deviation of a feature's position in the image, in pixels.
FEATURE_SIGMA_PX = 0.3


def depth_sigma_m(depth_m: Array) -> Array:
    """Standard deviation along the viewing ray, in meters; depth_m (N,)."""
    return INVERSE_DEPTH_SIGMA_PER_M * depth_m * depth_m


def lateral_sigma_m(depth_m: Array, focal_px: float) -> Array:
    """Standard deviation across the viewing ray, in meters; depth_m (N,)."""
    return depth_m * (FEATURE_SIGMA_PX / focal_px)
