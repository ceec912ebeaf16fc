"""How much light the lens loses towards the corners: learnt from places that move through the view.

Where the tangent of the angle to its axis is r, it shows 1 - falloff r^2 of what it shows in the
middle. Left out, whatever comes in from the side gets brighter, and a turn seems to be a little
less or more than it was. Goldman, "Vignette and Exposure Calibration and Compensation" (PAMI 32,
2010), who finds it with the exposure, as here.
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct import warping as reading_columns
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.keyframe_points import (
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.local_map import DirectKeyframe
from vo_service.odometry.direct.normal_equations import GAIN, OFFSET, SIGMA_BRIGHTNESS
from vo_service.odometry.direct.parameters import DECAY, DEGREES_OF_FREEDOM, HALF, SLIGHT
from vo_service.odometry.direct.warping import squared_radius_change

# A single view is off by this (sigma), how many readings it may have: surfaces shine, and lamps are
# near.
VIEW_SIGMA = HALF * SLIGHT


@dataclass(frozen=True)
class VignettingEstimate:
    """What is known of it.

    value        0 for none
    information  1 / variance of it
    """

    value: float = 0.0
    information: float = SLIGHT**-2

    def update(
        self, keyframe: DirectKeyframe, images: ImagePyramid, alignment: DirectAlignment
    ) -> "VignettingEstimate":
        """The same, by a view in which the keyframe's points have moved far."""
        H, g = _regress(
            keyframe.points[0],
            alignment.samples,
            alignment.cell_weights,
            alignment.residual_model,
            images.intrinsics[0],
        )
        if H[2, 2] <= 0.0:
            return self
        inverse = np.linalg.inv(H + 1e-9 * np.diag(np.diag(H)) + 1e-9 * np.eye(3))
        told = images.vignetting + float(inverse[2] @ g)
        known = DECAY * self.information
        more = 1.0 / (VIEW_SIGMA**2 + float(inverse[2, 2]))
        value = (known * self.value + more * told) / (known + more)
        return VignettingEstimate(min(max(value, -HALF), HALF), known + more)


@kernel
def _regress(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array, intrinsics: Array
) -> tuple[Array, Array]:
    """Normal equations (3, 3) and (3,) of changes of gain, offset and falloff."""
    H, g, J = np.zeros((3, 3)), np.zeros(3), np.ones(3)
    for i in range(len(points)):
        brightness = samples[i, reading_columns.SAMPLE_BRIGHTNESS]
        if np.isnan(brightness) or points[i, HAS_TEXTURE] == 0:
            continue
        u, v = samples[i, reading_columns.SAMPLE_U], samples[i, reading_columns.SAMPLE_V]
        mine = residual_model[GAIN] * points[i, POINT_BRIGHTNESS]
        residual = brightness - mine - residual_model[OFFSET]
        of_this = residual_model[SIGMA_BRIGHTNESS] ** 2 + points[i, POINT_BRIGHTNESS_VARIANCE]
        w = (
            (DEGREES_OF_FREEDOM + 1.0)
            / (DEGREES_OF_FREEDOM + residual * residual / of_this)
            / of_this
        )
        w *= cell_weights[0, int(samples[i, reading_columns.SAMPLE_CELL])]
        J[0], J[2] = mine, -mine * squared_radius_change(u, v, intrinsics, points[i])
        for a in range(3):
            for b in range(3):
                H[a, b] += w * J[a] * J[b]
            g[a] += w * J[a] * residual
    return H, g
