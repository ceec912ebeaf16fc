"""What many views tell of brightness: its weight against depth, and the vignetting of the lens.

Blur, shadows, reflections, and depth that is registered to color with an error of a pixel shift the
brightness of a whole region. Its samples then count as fewer ones. How many fewer is shown by the
scores of the image's cells, see `covariance`.

Vignetting: where the tangent of the angle to the optical axis is r, the brightness is
1 - vignetting r^2 of that in the center. Without this model, points that enter at the side get
brighter, and rotations are biased. As in Goldman, "Vignette and Exposure Calibration and
Compensation" (PAMI 32, 2010), it is estimated together with the exposure.
"""

from dataclasses import dataclass
from math import exp, log

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.factor import brightness_residual, student_weight
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.parameters import (
    BRIGHTNESS_WEIGHT,
    INDEPENDENT_BRIGHTNESS_WEIGHT,
    KEYFRAME_DECAY,
    MAX_VIGNETTING,
    SHARED_ERROR_DECAY,
    VIGNETTING_PRIOR_SIGMA,
    VIGNETTING_VIEW_SIGMA,
)
from vo_service.odometry.direct.points import (
    Points,
)
from vo_service.odometry.direct.residuals import ResidualModel
from vo_service.odometry.direct.samples import Samples, squared_radius_change

# Added to the diagonal of a matrix before a system is solved, relative to its trace or diagonal.
REGULARIZATION = 1e-9


@dataclass(frozen=True)
class BrightnessWeight:
    """Weight of brightness relative to depth.

    Attributes:
        log_shared_error: Mean logarithm of the ratio by which shared errors enlarge the scatter of
            the scores; 0 for independent samples.
        views: Number of views.
    """

    log_shared_error: float = float(np.log(INDEPENDENT_BRIGHTNESS_WEIGHT / BRIGHTNESS_WEIGHT))
    views: int = 0

    @property
    def value(self) -> float:
        """The weight."""
        return INDEPENDENT_BRIGHTNESS_WEIGHT * exp(-self.log_shared_error)

    def update(self, shared_error: float) -> "BrightnessWeight":
        """Return the weight updated by the `MotionUncertainty.shared_error` of a view."""
        if shared_error == 0.0:
            return self
        # The initial value counts as a view.
        step = max(1.0 - SHARED_ERROR_DECAY, 1.0 / (self.views + 2))
        change = log(shared_error) - self.log_shared_error
        return BrightnessWeight(self.log_shared_error + step * change, self.views + 1)


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
        """Return the estimate updated by a view in which the keyframe's points have moved far.

        Args:
            keyframe: The keyframe.
            images: The frame.
            alignment: Of the frame with the keyframe.
        """
        H, g = _regress(
            keyframe.points[0],
            alignment.samples,
            alignment.cell_weights,
            alignment.residual_model,
            images.intrinsics[0],
        )
        if H[1, 1] <= 0.0:
            return self
        inverse = np.linalg.inv(
            H + REGULARIZATION * np.diag(np.diag(H)) + REGULARIZATION * np.eye(2)
        )
        measured = images.vignetting + float(inverse[1] @ g)
        prior_information = KEYFRAME_DECAY * self.information
        view_information = 1.0 / (VIGNETTING_VIEW_SIGMA**2 + float(inverse[1, 1]))
        information = prior_information + view_information
        value = (prior_information * self.value + view_information * measured) / information
        return VignettingEstimate(min(max(value, -MAX_VIGNETTING), MAX_VIGNETTING), information)


@kernel
def _regress(
    points: Points,
    samples: Samples,
    cell_weights: Array,
    residual_model: ResidualModel,
    intrinsics: Array,
) -> tuple[Array, Array]:
    """Normal equations (2, 2) and (2,) of changes of gain and vignetting."""
    H, g, J = np.zeros((2, 2)), np.zeros(2), np.empty(2)
    for i in range(len(points.brightness)):
        brightness = samples.brightness[i]
        if np.isnan(brightness) or not points.has_texture[i]:
            continue
        u, v = samples.u[i], samples.v[i]
        expected = residual_model.gain * points.brightness[i]
        residual = brightness_residual(brightness, points.brightness[i], residual_model.gain)
        variance = residual_model.sigma_brightness**2 + points.brightness_variance[i]
        w = student_weight(residual, variance)
        w *= cell_weights[0, samples.cell[i]]
        change = squared_radius_change(u, v, intrinsics, points.position_m, i)
        J[0], J[1] = expected, -expected * change
        for a in range(2):
            for b in range(2):
                H[a, b] += w * J[a] * J[b]
            g[a] += w * J[a] * residual
    return H, g
