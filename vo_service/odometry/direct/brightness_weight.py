"""Weight of brightness against depth, by the errors that neighboring brightness samples share.

Blur, shadows, reflections, and depth that is registered to color with an error of a pixel shift the
brightness of a whole region. Its samples then count as fewer ones. How many fewer is shown by the
scores of the image's cells: they scatter more than independent samples would make them (Liang and
Zeger, Biometrika 73, 1986, as in `covariance`).
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.gauss_newton import fill_jacobian
from vo_service.odometry.direct.image_pyramid import NUM_CELLS
from vo_service.odometry.direct.keyframe_points import (
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.parameters import (
    BRIGHTNESS_WEIGHT,
    BRIGHTNESS_WEIGHT_RANGE,
    INDEPENDENT_BRIGHTNESS_WEIGHT,
    INITIAL_SHARED_ERROR_VIEWS,
    MIN_SHARED_ERROR_SAMPLES,
    SHARED_ERROR_DECAY,
)
from vo_service.odometry.direct.residuals import GAIN, OFFSET, SIGMA_BRIGHTNESS, student_weight
from vo_service.odometry.direct.warping import SAMPLE_BRIGHTNESS, SAMPLE_CELL

# Added to the diagonal of a matrix, relative to its trace, before a system is solved.
REGULARIZATION = 1e-9


@dataclass(frozen=True)
class BrightnessWeight:
    """Weight of brightness relative to depth.

    Attributes:
        log_shared_error: Mean logarithm of the ratio by which shared errors enlarge the scatter of
            the scores; 0 for independent samples.
        views: Number of views in that mean.
    """

    log_shared_error: float = float(np.log(INDEPENDENT_BRIGHTNESS_WEIGHT / BRIGHTNESS_WEIGHT))
    views: int = INITIAL_SHARED_ERROR_VIEWS

    @property
    def value(self) -> float:
        """The weight."""
        weight = INDEPENDENT_BRIGHTNESS_WEIGHT * float(np.exp(-self.log_shared_error))
        return min(max(weight, BRIGHTNESS_WEIGHT_RANGE[0]), BRIGHTNESS_WEIGHT_RANGE[1])

    def update(self, points: Array, alignment: DirectAlignment) -> "BrightnessWeight":
        """Return the weight updated by a view.

        Args:
            points: (N, COLUMNS) of the keyframe's finest level.
            alignment: Of the view with them.
        """
        scores, independent, count = _accumulate_scores(
            points, alignment.samples, alignment.cell_weights, alignment.residual_model
        )
        trace = np.trace(independent)
        if count < MIN_SHARED_ERROR_SAMPLES or trace <= 0.0:
            return self
        ratios = np.linalg.solve(
            independent + REGULARIZATION * trace * np.eye(6), scores.T @ scores
        )
        shared_error = float(np.trace(ratios)) / 6.0
        step = max(1.0 - SHARED_ERROR_DECAY, 1.0 / self.views)
        change = float(np.log(shared_error)) - self.log_shared_error
        return BrightnessWeight(self.log_shared_error + step * change, self.views + 1)


@kernel
def _accumulate_scores(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array
) -> tuple[Array, Array, int]:
    """(CELLS, 6) sums of the scores w r J, (6, 6) sum of their outer products, and their number."""
    scores, products = np.zeros((NUM_CELLS, 6)), np.zeros((6, 6))
    J, count = np.empty(6), 0
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    for i in range(len(points)):
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        if np.isnan(brightness) or points[i, HAS_TEXTURE] == 0:
            continue
        cell = int(samples[i, SAMPLE_CELL])
        residual = brightness - gain * points[i, POINT_BRIGHTNESS] - offset
        variance = residual_model[SIGMA_BRIGHTNESS] ** 2 + points[i, POINT_BRIGHTNESS_VARIANCE]
        weighted = student_weight(residual, variance) * cell_weights[0, cell] * residual
        fill_jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, weighted, J)
        count += weighted != 0.0
        for a in range(6):
            scores[cell, a] += J[a]
            for b in range(6):
                products[a, b] += J[a] * J[b]
    return scores, products, count
