"""The odometry methods by name.

A method is a function of `MethodConfig` and a stage timer in the entry-point group
`kinect_vo.odometry`. It is imported when it is created: its kernels are slow to load, and most
commands need none.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.core import InputError, PluginGroup
from vo_service.types.odometry import ImmediateWork, NullStageTimer, Odometry, StageTimer, WorkQueue

DEFAULT_METHOD = "direct"
MIN_FEATURES, MAX_FEATURES = 50, 5000
# Whether readout and delay of the sensor are learned while the odometry runs.
DEFAULT_TIMING_MODE, FIXED_TIMING_MODE = TIMING_MODES = ("learned", "fixed")
# How much a method computes. Only "direct" has a small profile; the others ignore it.
DEFAULT_PROFILE, SMALL_PROFILE = PROFILES = ("default", "small")


@dataclass(frozen=True)
class MethodConfig:
    """Settings of the methods; each takes those that it has.

    Attributes:
        count: SURF features in a frame.
        upright: Whether the camera never rolls.
        timing: One of `TIMING_MODES`.
        profile: One of `PROFILES`.
        deferred: Takes work that is not needed for the estimate of the same frame.
    """

    count: int = 1000
    upright: bool = False
    timing: str = DEFAULT_TIMING_MODE
    profile: str = DEFAULT_PROFILE
    deferred: WorkQueue = field(default_factory=ImmediateWork)


OWN_METHODS = ("surf", "icp", "sfm", "direct")
METHODS: PluginGroup[Callable[[MethodConfig, StageTimer], Odometry]] = PluginGroup(
    "kinect_vo.odometry", "method", OWN_METHODS
)


def make_odometry(
    method: str = DEFAULT_METHOD,
    *,
    feature_count: int = 1000,
    upright: bool = False,
    timing: str = DEFAULT_TIMING_MODE,
    profile: str = DEFAULT_PROFILE,
    timer: StageTimer = NullStageTimer(),  # noqa: B008 (it has no state)
    deferred: WorkQueue = ImmediateWork(),  # noqa: B008 (the same)
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
        timing: "learned" (only "direct": readout and delay of the sensor and the focal length are
            learned, if the frames do not tell the timing exactly) or "fixed" (as the frames tell).
        profile: "default", or "small" for a small board (only "direct": half the points, and a
            pyramid level less).
        timer: Times the stages of each frame.
        deferred: Takes work that is not needed for the estimate of the same frame, such as making
            keyframes and learning (only "direct"). With a `DeferredWork`, its `run` has to be
            called after each estimate.

    Raises:
        InputError: The method, the timing or the profile is unknown, or the number of features is
            out of range.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; use one of {', '.join(METHODS)}")
    if not MIN_FEATURES <= feature_count <= MAX_FEATURES:
        raise InputError(
            f"feature_count {feature_count}: must be from {MIN_FEATURES} to {MAX_FEATURES}"
        )
    if timing not in TIMING_MODES:
        raise InputError(f"timing {timing!r} is unknown; use one of {', '.join(TIMING_MODES)}")
    if profile not in PROFILES:
        raise InputError(f"profile {profile!r} is unknown; use one of {', '.join(PROFILES)}")
    return METHODS[method](MethodConfig(feature_count, upright, timing, profile, deferred), timer)


def make_surf(features: MethodConfig, timer: StageTimer) -> Odometry:
    """Frame to frame by SURF features."""
    from vo_service.odometry.features.extractor import SurfExtractor
    from vo_service.odometry.surf.odometry import SurfOdometry

    return SurfOdometry(SurfExtractor(features.count, features.upright), timer=timer)


def make_direct(features: MethodConfig, timer: StageTimer) -> Odometry:
    """Brightness and depth against keyframes; SURF features for recovery."""
    from vo_service.odometry.direct.image_halving import HalvingOdometry
    from vo_service.odometry.direct.odometry import DirectOdometry
    from vo_service.odometry.direct.parameters import POINT_BLOCKS, SMALL_POINT_BLOCKS
    from vo_service.odometry.direct.repeated_depth import RepeatedDepthFilter
    from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
    from vo_service.odometry.features.extractor import SurfExtractor

    extractor = SurfExtractor(features.count, features.upright)
    point_blocks = {DEFAULT_PROFILE: POINT_BLOCKS, SMALL_PROFILE: SMALL_POINT_BLOCKS}
    deferred = features.deferred
    tracker = DirectOdometry(extractor, timer, point_blocks[features.profile], deferred)
    is_fixed = features.timing == FIXED_TIMING_MODE
    odometry = tracker if is_fixed else SelfCalibratingOdometry(tracker, timer, deferred)
    return RepeatedDepthFilter(HalvingOdometry(odometry))


def make_icp(_features: MethodConfig, timer: StageTimer) -> Odometry:
    """Depth only, point-to-plane ICP."""
    from vo_service.odometry.icp.odometry import IcpOdometry

    return IcpOdometry(timer=timer)


def make_sfm(features: MethodConfig, timer: StageTimer) -> Odometry:
    """Color only; the initial scale is from the first depth image."""
    from vo_service.odometry.features.extractor import SurfExtractor
    from vo_service.odometry.sfm.odometry import SfmOdometry

    return SfmOdometry(SurfExtractor(features.count, features.upright), timer=timer)
