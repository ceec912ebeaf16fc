"""Where the first scale comes from: color alone has none.

This is the one place where structure from motion may look at depth, and at that of the first
frame alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.feature_points import backproject_features
from vo_service.odometry.surf import Features

# Fewer points than this with depth say too little, and so do two stamps of one place.
MIN_POINTS = 15
MIN_BASELINE_M = 1e-3
# From the median of the absolute deviations to a standard deviation; and how much less sure than
# the mean of as many the median is (both of normal errors).
SIGMA_PER_MAD, MEDIAN_SIGMA_PER_MEAN_SIGMA = 1.4826, 1.2533
# A baseline that is given is not exact either.
BASELINE_SIGMA = 0.01


@dataclass(frozen=True)
class InitialPair:
    """The first two views with parallax: their motion, of length 1, and the points in that unit.

    frame           of the first view
    features        of the first view
    stamp_s         of the second view
    index           (K,) which features were triangulated
    inverse_depth   (K,) of those in the first view, 1 / length of the motion
    """

    frame: RgbdFrame
    features: Features
    stamp_s: float
    index: NDArray[np.int64]
    inverse_depth: Array


@dataclass(frozen=True)
class MetricScale:
    """Metres a unit, and the standard deviation of the logarithm of it."""

    metres_per_unit: float
    log_sigma: float


class ScaleSource(Protocol):
    """Tells the first scale, once in each chain of frames."""

    @property
    def name(self) -> str:
        """For reports: "first depth", "given baseline"."""
        ...

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """How long the first motion is; None where it cannot be told."""
        ...


class FirstDepthScale:
    """The depth image of the first frame: the median over the points of both."""

    name = "first depth"

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """See `ScaleSource`. None if fewer than 15 of the points have depth."""
        depth_m = backproject_features(pair.features, pair.frame).position_m[pair.index, 2]
        ratio = (depth_m * pair.inverse_depth)[depth_m > 0.0]
        ratio = ratio[ratio > 0.0]
        if len(ratio) < MIN_POINTS:
            return None
        metres_per_unit = float(np.median(ratio))
        return MetricScale(metres_per_unit, median_sigma(np.log(ratio)))


class GivenBaselineScale:
    """The distance between the places of two frames, by their stamps: motion capture, say."""

    name = "given baseline"

    def __init__(self, distance_m: Callable[[float, float], float]) -> None:
        self._distance_m = distance_m

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """See `ScaleSource`. None if the places are the same to within a millimetre.

        Raises what the function given raises.
        """
        distance_m = self._distance_m(pair.frame.stamp_s, pair.stamp_s)
        if not MIN_BASELINE_M < distance_m < np.inf:
            return None
        return MetricScale(distance_m, BASELINE_SIGMA)


def median_sigma(values: Array) -> float:
    """Standard deviation of the median of (N,) values, from their own spread; N at least 1."""
    deviation = np.abs(values - np.median(values))
    spread = SIGMA_PER_MAD * float(np.median(deviation))
    return MEDIAN_SIGMA_PER_MEAN_SIGMA * spread / float(np.sqrt(len(values)))
