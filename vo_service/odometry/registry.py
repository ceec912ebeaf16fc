"""Registry of the odometry methods by name. A new method is added here.

A method is imported when it is created: its kernels are slow to load, and most commands need none.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from vo_service.odometry.direct.stage_budget import STAGE_BUDGET_MS
from vo_service.odometry.profiling import StageTimer
from vo_service.types import Odometry

DEFAULT_METHOD = "direct"


@dataclass(frozen=True)
class FeatureConfig:
    """Settings of the features, for all methods that use them."""

    count: int = 1000
    upright: bool = False


def _make_surf(features: FeatureConfig, timer: StageTimer) -> Odometry:
    """Frame to frame by SURF features."""
    from vo_service.odometry.surf import SurfExtractor
    from vo_service.odometry.surf.odometry import SurfOdometry

    return SurfOdometry(SurfExtractor(features.count, features.upright), timer=timer)


def _make_direct(features: FeatureConfig, timer: StageTimer) -> Odometry:
    """Brightness and depth against keyframes; SURF features for recovery."""
    from vo_service.odometry.direct.odometry import DirectOdometry
    from vo_service.odometry.surf import SurfExtractor

    return DirectOdometry(SurfExtractor(features.count, features.upright), timer=timer)


def _make_icp(_features: FeatureConfig, timer: StageTimer) -> Odometry:
    """Depth only, point-to-plane ICP."""
    from vo_service.odometry.icp.odometry import IcpOdometry

    return IcpOdometry(timer=timer)


def _make_sfm(features: FeatureConfig, timer: StageTimer) -> Odometry:
    """Color only; the initial scale is from the first depth image."""
    from vo_service.odometry.sfm.odometry import SfmOdometry
    from vo_service.odometry.surf import SurfExtractor

    return SfmOdometry(SurfExtractor(features.count, features.upright), timer=timer)


METHODS: Mapping[str, Callable[[FeatureConfig, StageTimer], Odometry]] = {
    "surf": _make_surf,
    "icp": _make_icp,
    "sfm": _make_sfm,
    "direct": _make_direct,
}

# Processor time per frame of the stages in milliseconds, for methods with a budget.
STAGE_BUDGETS_MS: Mapping[str, Mapping[str, float]] = {"direct": STAGE_BUDGET_MS}
