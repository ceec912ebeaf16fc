"""The odometry methods by name: the one place where a new estimator is listed.

A method is imported when it is made: its kernels are slow to load, and most commands need none.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from vo_service.odometry.keyframe.budget import BUDGET_MS
from vo_service.odometry.stopwatch import Stopwatch
from vo_service.types import Odometry

DEFAULT_METHOD = "keyframe"


@dataclass(frozen=True)
class FeatureSettings:
    """What the methods that use features share."""

    count: int = 1000
    upright: bool = False


def _surf(features: FeatureSettings, stopwatch: Stopwatch) -> Odometry:
    """The paper's method."""
    from vo_service.odometry.surf import SurfExtractor
    from vo_service.odometry.surf_odometry import SurfOdometry

    return SurfOdometry(SurfExtractor(features.count, features.upright), stopwatch=stopwatch)


def _keyframe(features: FeatureSettings, stopwatch: Stopwatch) -> Odometry:
    """Brightness and depth against keyframes; features where that fails."""
    from vo_service.odometry.keyframe_odometry import KeyframeOdometry
    from vo_service.odometry.surf import SurfExtractor

    return KeyframeOdometry(SurfExtractor(features.count, features.upright), stopwatch=stopwatch)


def _icp(_features: FeatureSettings, stopwatch: Stopwatch) -> Odometry:
    """Depth alone, point to plane."""
    from vo_service.odometry.icp_odometry import IcpOdometry

    return IcpOdometry(stopwatch=stopwatch)


def _sfm(features: FeatureSettings, stopwatch: Stopwatch) -> Odometry:
    """Colour alone; the first scale is that of the first depth."""
    from vo_service.odometry.sfm_odometry import SfmOdometry
    from vo_service.odometry.surf import SurfExtractor

    return SfmOdometry(SurfExtractor(features.count, features.upright), stopwatch=stopwatch)


METHODS: Mapping[str, Callable[[FeatureSettings, Stopwatch], Odometry]] = {
    "surf": _surf,
    "icp": _icp,
    "sfm": _sfm,
    "keyframe": _keyframe,
}

# Milliseconds of processor time a frame that stages may take, of methods that have such budgets.
BUDGETS_MS: Mapping[str, Mapping[str, float]] = {"keyframe": BUDGET_MS}
