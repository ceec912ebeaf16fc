"""Sources of the initial scale, which color alone does not give.

Only here structure from motion uses depth, and only that of the first frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.features import backproject_features
from vo_service.odometry.surf import Features

# Fewest points with depth, and shortest baseline, for a scale.
MIN_POINTS = 15
MIN_BASELINE_M = 1e-3
# Ratios for normal errors: sigma to the median absolute deviation, and sigma of the median to that
# of the mean.
SIGMA_PER_MAD, MEDIAN_SIGMA_PER_MEAN_SIGMA = 1.4826, 1.2533
# Relative sigma of a known baseline.
BASELINE_SIGMA = 0.01


@dataclass(frozen=True)
class InitialPair:
    """The first two views with parallax: their points in units of their motion's length.

    Attributes:
        frame: The first view.
        features: Of the first view.
        stamp_s: Of the second view.
        index: (K,) indices of the triangulated features.
        inverse_depth: (K,) of these in the first view, 1 / length of the motion.
    """

    frame: RgbdFrame
    features: Features
    stamp_s: float
    index: NDArray[np.int64]
    inverse_depth: Array


@dataclass(frozen=True)
class MetricScale:
    """Meters per unit, and the standard deviation of its logarithm."""

    metres_per_unit: float
    log_sigma: float


class ScaleSource(Protocol):
    """Source of the initial scale, used once in each chain of frames."""

    @property
    def name(self) -> str:
        """Name for messages, such as "depth of the first frame"."""
        ...

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """Estimate the length of the first motion; None if it is unknown."""
        ...


class FirstDepthScale:
    """Scale by the depth image of the first frame: the median ratio over the points."""

    name = "depth of the first frame"

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """Estimate the scale; None if fewer than `MIN_POINTS` points have depth."""
        depth_m = backproject_features(pair.features, pair.frame).position_m[pair.index, 2]
        ratio = (depth_m * pair.inverse_depth)[depth_m > 0.0]
        ratio = ratio[ratio > 0.0]
        if len(ratio) < MIN_POINTS:
            return None
        metres_per_unit = float(np.median(ratio))
        return MetricScale(metres_per_unit, median_sigma(np.log(ratio)))


class GivenBaselineScale:
    """Scale by the distance between two frames by their stamps, such as from motion capture."""

    name = "known baseline"

    def __init__(self, distance_m: Callable[[float, float], float]) -> None:
        self._distance_m = distance_m

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """Estimate the scale; None if the distance is less than `MIN_BASELINE_M`.

        Errors of the given function are passed on.
        """
        distance_m = self._distance_m(pair.frame.stamp_s, pair.stamp_s)
        if not MIN_BASELINE_M < distance_m < np.inf:
            return None
        return MetricScale(distance_m, BASELINE_SIGMA)


def median_sigma(values: Array) -> float:
    """Standard deviation of the median of (N,) values, from their scatter; N is at least 1."""
    deviation = np.abs(values - np.median(values))
    sigma = SIGMA_PER_MAD * float(np.median(deviation))
    return MEDIAN_SIGMA_PER_MEAN_SIGMA * sigma / float(np.sqrt(len(values)))
