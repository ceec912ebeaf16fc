"""Noise of the depth sensor, learned from planes in the depth images.

Most of what a camera sees is smooth, so that 1/z is a linear function of the pixel in most of its
small windows. What is left after a fit is the noise of the sensor: of its disparity or its time of
flight, with their quantization.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from vo_service.odometry.depth_planes import fit_plane
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.parameters import (
    DEPTH_NOISE_PER_M,
    KEYFRAME_DECAY,
    MAX_NOISE_STEP_PER_M,
    MAX_SURFACE_STEP_SHARE,
    MIN_PLANE_SUPPORT,
    MIN_SIGMA_SAMPLES,
    NOISE_GRID_PX,
    PLANE_RADIUS_PX,
    PLANE_STEP_PX,
)


@dataclass(frozen=True)
class DepthNoise:
    """Sigma of the inverse depth of a pixel.

    Attributes:
        measured_per_m: Fading mean of the measurements, 1/m; None before the first one.
    """

    measured_per_m: float | None = None

    @property
    def value_per_m(self) -> float:
        """The sigma in use, 1/m."""
        if self.measured_per_m is None:
            return DEPTH_NOISE_PER_M
        return max(self.measured_per_m, DEPTH_NOISE_PER_M)

    def update(self, images: ImagePyramid) -> "DepthNoise":
        """Return the noise updated by a frame."""
        residuals = _plane_residuals(images.depth.inverse)
        if len(residuals) < MIN_SIGMA_SAMPLES:
            return self
        measured = float(np.median(residuals))
        before = measured if self.measured_per_m is None else self.measured_per_m
        return DepthNoise(KEYFRAME_DECAY * before + (1.0 - KEYFRAME_DECAY) * measured)


@kernel
def _plane_residuals(inverse_depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N,) root mean square residuals of planes on a grid of pixels, 1/m."""
    height, width = inverse_depth.shape
    margin, radius = PLANE_RADIUS_PX, PLANE_RADIUS_PX // PLANE_STEP_PX
    residuals, count = np.empty((height // NOISE_GRID_PX + 1) * (width // NOISE_GRID_PX + 1)), 0
    for row in range(margin, height - margin, NOISE_GRID_PX):
        for column in range(margin, width - margin, NOISE_GRID_PX):
            max_step = MAX_SURFACE_STEP_SHARE * inverse_depth[row, column] + MAX_NOISE_STEP_PER_M
            w, _, _, squared = fit_plane(
                inverse_depth, column, row, radius, PLANE_STEP_PX, max_step, MIN_PLANE_SUPPORT
            )
            if w > 0.0:
                residuals[count] = np.sqrt(squared)
                count += 1
    return residuals[:count]
