"""Noise of the depth sensor, learned from planes in the depth images.

Most of what a camera sees is smooth, so that 1/z is a linear function of the pixel in most of its
small windows. What is left after a fit is the noise of the sensor: of its disparity or its time of
flight, with their quantization. Errors that a whole window shares, as those of stereo, are not in
it: two images differ by them.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from vo_service.odometry.depth_planes import fit_plane
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.parameters import (
    DEPTH_NOISE_PER_M,
    KEYFRAME_DECAY,
    MAX_NOISE_STEP_PER_M,
    MAX_SURFACE_STEP_SHARE,
    MAX_VALID_RATIOS,
    MIN_PLANE_SUPPORT,
    MIN_SIGMA_SAMPLES,
    NOISE_WINDOWS,
    PLANE_RADIUS_PX,
    PLANE_STEP_PX,
)
from vo_service.odometry.direct.quality import relative_sigmas


@dataclass(frozen=True)
class DepthNoise:
    """Sigma of the inverse depth of a pixel.

    Attributes:
        in_windows_per_m: Fading mean of the measurements, 1/m; None before the first one.
        shared_ratio: Ratio of the whole sigma to that within windows.
    """

    in_windows_per_m: float | None = None
    shared_ratio: float = 1.0

    @property
    def measured_per_m(self) -> float | None:
        """The measured sigma, 1/m; None before the first measurement."""
        return None if self.in_windows_per_m is None else self.shared_ratio * self.in_windows_per_m

    @property
    def value_per_m(self) -> float:
        """The sigma in use, 1/m."""
        return self.shared_ratio * max(self.in_windows_per_m or 0.0, DEPTH_NOISE_PER_M)

    def raised_for(self, alignment: DirectAlignment) -> "DepthNoise":
        """Return the noise with which the depth of an alignment fits, whose motion is right.

        It is the same if the depth fits already, or if no sensor is as bad.
        """
        misfit = relative_sigmas(alignment)[1]
        raised = replace(self, shared_ratio=MAX_VALID_RATIOS[1] * misfit * self.shared_ratio)
        return raised if misfit > 1.0 and raised.value_per_m < MAX_NOISE_STEP_PER_M else self

    def update(self, images: ImagePyramid) -> "DepthNoise":
        """Return the noise updated by a frame."""
        residuals = _plane_residuals(images.depth.inverse)
        if len(residuals) < MIN_SIGMA_SAMPLES:
            return self
        measured = float(np.median(residuals))
        before = measured if self.in_windows_per_m is None else self.in_windows_per_m
        faded = KEYFRAME_DECAY * before + (1.0 - KEYFRAME_DECAY) * measured
        return replace(self, in_windows_per_m=faded)


@kernel
def _plane_residuals(inverse_depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N,) root mean square residuals of planes on a grid of pixels, 1/m."""
    height, width = inverse_depth.shape
    margin, radius = PLANE_RADIUS_PX, PLANE_RADIUS_PX // PLANE_STEP_PX
    step = max(max(height, width) // NOISE_WINDOWS, 1)
    residuals, count = np.empty((height // step + 1) * (width // step + 1)), 0
    for row in range(margin, height - margin, step):
        for column in range(margin, width - margin, step):
            max_step = MAX_SURFACE_STEP_SHARE * inverse_depth[row, column] + MAX_NOISE_STEP_PER_M
            w, _, _, squared = fit_plane(
                inverse_depth, column, row, radius, PLANE_STEP_PX, max_step, MIN_PLANE_SUPPORT
            )
            if w > 0.0:
                residuals[count] = np.sqrt(squared)
                count += 1
    return residuals[:count]
