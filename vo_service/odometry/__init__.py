"""Odometry methods: their registry by name, their warm-up, and the timers of their stages.

Methods are pure: frames in, estimates out; no files, no threads. A method names its stages; the
caller provides the timer.

A method is a function of `MethodConfig` and a stage timer in the entry-point group
`kinect_vo.odometry`. It is imported when it is created: its kernels are slow to load, and most
commands need none. The warm-up compiles its kernels, or loads them from the cache, before the first
frame.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame, TimingPrior, TimingSource
from drivers.core import InputError, PluginGroup
from vo_service.types import NullStageTimer, Odometry, StageTimer

DEFAULT_METHOD = "direct"
MIN_FEATURES, MAX_FEATURES = 50, 5000
# Large enough for every filter and every octave.
IMAGE_SIZE_PX = 256
# Whether readout and delay of the sensor are learned while the odometry runs.
DEFAULT_TIMING_MODE, FIXED_TIMING_MODE = TIMING_MODES = ("learned", "fixed")


class _TimedStage:
    """One stage; a generator would cost more than some stages do."""

    def __init__(self, stages_ms: dict[str, float], name: str) -> None:
        self._stages_ms, self._name = stages_ms, name

    def __enter__(self) -> None:
        self._begin_s = time.thread_time()

    def __exit__(self, *_: object) -> None:
        elapsed_ms = (time.thread_time() - self._begin_s) * 1e3
        self._stages_ms[self._name] = self._stages_ms.get(self._name, 0.0) + elapsed_ms


class CpuStageTimer:
    """Timer that sums this thread's processor time by stage."""

    def __init__(self) -> None:
        self._stages_ms: dict[str, float] = {}

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Time one named stage."""
        return _TimedStage(self._stages_ms, name)

    def take_stage_ms(self) -> Mapping[str, float]:
        """Return and reset the milliseconds by stage."""
        stages_ms, self._stages_ms = self._stages_ms, {}
        return stages_ms


@dataclass(frozen=True)
class MethodConfig:
    """Settings of the methods; each takes those that it has.

    Attributes:
        count: SURF features in a frame.
        upright: Whether the camera never rolls.
        timing: One of `TIMING_MODES`.
    """

    count: int = 1000
    upright: bool = False
    timing: str = DEFAULT_TIMING_MODE


METHODS: PluginGroup[Callable[[MethodConfig, StageTimer], Odometry]] = PluginGroup(
    "kinect_vo.odometry", "method", ("surf", "icp", "sfm", "direct")
)


def make_odometry(
    method: str = DEFAULT_METHOD,
    *,
    feature_count: int = 1000,
    upright: bool = False,
    timing: str = DEFAULT_TIMING_MODE,
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
        timing: "learned" (only "direct": readout and delay of the sensor and the focal length are
            learned, if the frames do not tell the timing exactly) or "fixed" (as the frames tell).
        timer: Times the stages of each frame.

    Raises:
        InputError: The method or the timing is unknown, or the number of features is out of
            range.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; use one of {', '.join(METHODS)}")
    if not MIN_FEATURES <= feature_count <= MAX_FEATURES:
        raise InputError(
            f"feature_count {feature_count}: must be from {MIN_FEATURES} to {MAX_FEATURES}"
        )
    if timing not in TIMING_MODES:
        raise InputError(f"timing {timing!r} is unknown; use one of {', '.join(TIMING_MODES)}")
    return METHODS[method](MethodConfig(feature_count, upright, timing), timer)


def make_surf(features: MethodConfig, timer: StageTimer) -> Odometry:
    """Frame to frame by SURF features."""
    from vo_service.odometry.surf import SurfExtractor
    from vo_service.odometry.surf.odometry import SurfOdometry

    return SurfOdometry(SurfExtractor(features.count, features.upright), timer=timer)


def make_direct(features: MethodConfig, timer: StageTimer) -> Odometry:
    """Brightness and depth against keyframes; SURF features for recovery."""
    from vo_service.odometry.direct import DirectOdometry
    from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
    from vo_service.odometry.surf import SurfExtractor

    tracker = DirectOdometry(SurfExtractor(features.count, features.upright), timer=timer)
    if features.timing == FIXED_TIMING_MODE:
        return tracker
    return SelfCalibratingOdometry(tracker, timer=timer)


def make_icp(_features: MethodConfig, timer: StageTimer) -> Odometry:
    """Depth only, point-to-plane ICP."""
    from vo_service.odometry.icp.odometry import IcpOdometry

    return IcpOdometry(timer=timer)


def make_sfm(features: MethodConfig, timer: StageTimer) -> Odometry:
    """Color only; the initial scale is from the first depth image."""
    from vo_service.odometry.sfm.odometry import SfmOdometry
    from vo_service.odometry.surf import SurfExtractor

    return SfmOdometry(SurfExtractor(features.count, features.upright), timer=timer)


# Milliseconds of processor time by stage, as the mean over all frames, for methods with a budget.
# That of `direct` is with a rolling shutter; its sum is a quarter of one processor at 30 Hz.
# Without a rolling shutter, half of `align` is enough.
STAGE_BUDGETS_MS: Mapping[str, Mapping[str, float]] = {
    "direct": {
        "images": 0.5,
        "align": 4.2,
        "recovery": 1.0,
        "covariance": 1.0,
        "refine": 0.5,
        "keyframe": 0.5,
        "calibration": 0.5,
    }
}


class StageReporter:
    """Stage timer that only reports each stage's name."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Report the stage's name."""
        self._report(name)
        yield


def warm_up(method: str, report_stage: Callable[[str], None]) -> float:
    """Run a method on a few generated frames, which compiles its kernels for any image size.

    Args:
        method: Name of the method.
        report_stage: Called with the name of each stage when it starts.

    Returns:
        The elapsed seconds.
    """
    start_s = time.monotonic()
    run_warm_up_frames(lambda: METHODS[method](MethodConfig(), StageReporter(report_stage)))
    return time.monotonic() - start_s


def run_warm_up_frames(make_odometry: Callable[[], Odometry]) -> None:
    """Run new odometries on generated frames."""
    for frames in (_make_corner_frames(), _make_wall_frames(), _make_pan_frames()):
        odometry = make_odometry()
        for frame in frames:
            odometry.estimate(frame)


def _make_corner_frames() -> Iterator[RgbdFrame]:
    """A texture that moves over a corner; in the last frame another texture.

    From the fourth frame on most of the texture moves further, which gives parallax. In the last
    frame tracking is lost, so that the recovery runs as well.
    """
    for number, seed in enumerate((0, 0, 0, 0, 0, 1)):
        yield _make_frame(
            number,
            _shift_texture(_make_texture(seed), number),
            _make_corner_depth(2000 + 2000 * seed),
        )


def _make_wall_frames() -> Iterator[RgbdFrame]:
    """A texture that moves on a wall, first slowly, then by more than a quarter of the view.

    This runs the recovery and the selection of a new keyframe. The rows have slightly different
    times, so that the code for rolling shutters runs.
    """
    wall = np.full((IMAGE_SIZE_PX, IMAGE_SIZE_PX), 2000, np.uint16)
    for number, shift_px in enumerate((0, 2, 72)):
        frame = _make_frame(number, np.roll(_make_texture(0), shift_px, axis=1), wall)
        yield replace(frame, readout_s=1e-6)


def _make_pan_frames() -> Iterator[RgbdFrame]:
    """A texture that moves to and fro on a wall, with an uncertain timing, so that it is learned.

    It leaves the first keyframe and comes back to it, so that a frame is aligned with both. The
    wall recedes, which the texture does not: this takes more than one step.
    """
    prior = TimingPrior(0.0, 0.004, 0.002, TimingSource.SENSOR)
    wall = np.full((IMAGE_SIZE_PX, IMAGE_SIZE_PX), 2000, np.uint16)
    for number in range(20):
        shift_px = 8 * min(number, 19 - number)
        texture = np.roll(_make_texture(0), shift_px, axis=1)
        frame = _make_frame(number, texture, wall + np.uint16(2 * number))
        yield replace(frame, timing_prior=prior)


def _make_frame(
    number: int, color_bgr: NDArray[np.uint8], depth_raw: NDArray[np.uint16]
) -> RgbdFrame:
    return RgbdFrame(
        seq=number,
        stamp_s=number / 30,
        receive_time_s=0.0,
        color_bgr=color_bgr,
        depth_raw=depth_raw,
        depth_factor=1000.0,
        camera=PinholeCamera(
            IMAGE_SIZE_PX, IMAGE_SIZE_PX, 300.0, 300.0, IMAGE_SIZE_PX / 2, IMAGE_SIZE_PX / 2
        ),
    )


def _shift_texture(texture: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """Shift the texture by `number` pixels, and from the fourth frame on its lower part further."""
    shifted = np.roll(texture, number, axis=1)
    if number > 2:
        shifted[IMAGE_SIZE_PX // 3 :] = np.roll(
            shifted[IMAGE_SIZE_PX // 3 :], IMAGE_SIZE_PX // 5, axis=1
        )
    return shifted


def _make_corner_depth(depth_raw: int) -> NDArray[np.uint16]:
    """Three walls that meet in the center; they constrain all degrees of freedom."""
    v, u = np.mgrid[:IMAGE_SIZE_PX, :IMAGE_SIZE_PX] - IMAGE_SIZE_PX // 2
    nearer = np.maximum.reduce([v, -v // 2 + u, -v // 2 - u])
    corner: NDArray[np.uint16] = (depth_raw - 3 * nearer).astype(np.uint16)
    return corner


def _make_texture(seed: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(seed).integers(
        0, 256, (IMAGE_SIZE_PX // 8, IMAGE_SIZE_PX // 8), np.uint8
    )
    texture = np.kron(coarse, np.ones((8, 8), np.uint8))
    return np.repeat(texture[:, :, None], 3, axis=2)
