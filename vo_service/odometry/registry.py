"""Registry of the odometry methods by name. A new method is added here.

A method is imported when it is created: its kernels are slow to load, and most commands need none.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.core.errors import InputError
from vo_service.odometry.direct.stage_budget import STAGE_BUDGET_MS
from vo_service.odometry.profiling import NullStageTimer, StageTimer
from vo_service.types import Odometry

DEFAULT_METHOD = "direct"
MIN_FEATURES, MAX_FEATURES = 50, 5000


@dataclass(frozen=True)
class FeatureConfig:
    """Settings of the features, for all methods that use them."""

    count: int = 1000
    upright: bool = False


def make_odometry(
    method: str = DEFAULT_METHOD,
    *,
    feature_count: int = 1000,
    upright: bool = False,
    timer: StageTimer = NullStageTimer(),  # noqa: B008 (it has no state)
) -> Odometry:
    """Make an odometry, which starts at the first frame that it gets.

        odometry = make_odometry("direct")
        with open_camera("tum:recordings/desk") as camera:
            for frame in camera:
                estimate = odometry.estimate(frame)
                print(frame.stamp_s, estimate.ok, estimate.T_world_camera[:3, 3])

    Intrinsics come with each frame. The same frames give the same bits. Kernels are compiled at the
    first use, which takes about a minute, and then kept; `kinect-vo warm-up` compiles them before.

    Args:
        method: One of `METHODS`: "direct" (brightness and depth against keyframes), "surf" (SURF
            features), "icp" (depth only) or "sfm" (color only).
        feature_count: SURF features in a frame, from 50 to 5000; "icp" uses none.
        upright: Whether the camera never rolls: faster, and more matches.
        timer: Times the stages of each frame.

    Raises:
        InputError: The method is unknown, or the number of features is out of range.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; use one of {', '.join(METHODS)}")
    if not MIN_FEATURES <= feature_count <= MAX_FEATURES:
        raise InputError(
            f"feature_count {feature_count}: must be from {MIN_FEATURES} to {MAX_FEATURES}"
        )
    return METHODS[method](FeatureConfig(feature_count, upright), timer)


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
