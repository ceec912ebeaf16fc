"""Vignetting of the lens, estimated from points that move through the view.

Where the tangent of the angle to the optical axis is r, the brightness is 1 - vignetting r^2 of
that in the center. Without this model, points that enter at the side get brighter, and rotations
are biased. As in Goldman, "Vignette and Exposure Calibration and Compensation" (PAMI 32, 2010), it
is estimated together with the exposure.
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.keyframe_points import (
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.parameters import (
    MAX_VIGNETTING,
    VIGNETTING_DECAY,
    VIGNETTING_PRIOR_SIGMA,
    VIGNETTING_VIEW_SIGMA,
)
from vo_service.odometry.direct.residuals import GAIN, OFFSET, SIGMA_BRIGHTNESS, student_weight
from vo_service.odometry.direct.warping import (
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_U,
    SAMPLE_V,
    squared_radius_change,
)

# Added to the information relative to its diagonal, and to the diagonal itself.
REGULARIZATION = 1e-9


@dataclass(frozen=True)
class VignettingEstimate:
    """Estimate of the vignetting.

    Attributes:
        value: 0 for none.
        information: 1 / variance.
    """

    value: float = 0.0
    information: float = VIGNETTING_PRIOR_SIGMA**-2

    def update(
        self, keyframe: DirectKeyframe, images: ImagePyramid, alignment: DirectAlignment
    ) -> "VignettingEstimate":
        """Return the estimate updated by a view in which the keyframe's points have moved far."""
        H, g = _regress(
            keyframe.points[0],
            alignment.samples,
            alignment.cell_weights,
            alignment.residual_model,
            images.intrinsics[0],
        )
        if H[2, 2] <= 0.0:
            return self
        inverse = np.linalg.inv(
            H + REGULARIZATION * np.diag(np.diag(H)) + REGULARIZATION * np.eye(3)
        )
        measured = images.vignetting + float(inverse[2] @ g)
        prior_information = VIGNETTING_DECAY * self.information
        view_information = 1.0 / (VIGNETTING_VIEW_SIGMA**2 + float(inverse[2, 2]))
        information = prior_information + view_information
        value = (prior_information * self.value + view_information * measured) / information
        return VignettingEstimate(min(max(value, -MAX_VIGNETTING), MAX_VIGNETTING), information)


@kernel
def _regress(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array, intrinsics: Array
) -> tuple[Array, Array]:
    """Normal equations (3, 3) and (3,) of changes of gain, offset and vignetting."""
    H, g, J = np.zeros((3, 3)), np.zeros(3), np.ones(3)
    for i in range(len(points)):
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        if np.isnan(brightness) or points[i, HAS_TEXTURE] == 0:
            continue
        u, v = samples[i, SAMPLE_U], samples[i, SAMPLE_V]
        expected = residual_model[GAIN] * points[i, POINT_BRIGHTNESS]
        residual = brightness - expected - residual_model[OFFSET]
        variance = residual_model[SIGMA_BRIGHTNESS] ** 2 + points[i, POINT_BRIGHTNESS_VARIANCE]
        w = student_weight(residual, variance)
        w *= cell_weights[0, int(samples[i, SAMPLE_CELL])]
        J[0], J[2] = expected, -expected * squared_radius_change(u, v, intrinsics, points[i])
        for a in range(3):
            for b in range(3):
                H[a, b] += w * J[a] * J[b]
            g[a] += w * J[a] * residual
    return H, g
