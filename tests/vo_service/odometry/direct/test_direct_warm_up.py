"""The warm-up compiles all kernels of the direct odometry."""

import pkgutil
from dataclasses import replace
from importlib import import_module

import numpy as np

from drivers.calibration import UNKNOWN_TIMING
from drivers.camera import RgbdFrame, TimingPrior, TimingSource
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    MovingCamera,
    add_noise,
    remove_color,
    render_sequence,
    render_view,
)
from vo_service.odometry import depth_planes, direct, ransac
from vo_service.odometry.features import descriptor, detector, matching
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.stage_timers import STAGE_BUDGETS_MS, StageReporter
from vo_service.odometry.warm_up import warm_up

OWN = [f"{direct.__name__}.{each.name}" for each in pkgutil.iter_modules(direct.__path__)]
SHARED = [depth_planes, matching, ransac, descriptor, detector]
MODULES = [*map(import_module, OWN), *SHARED]
KERNELS = [
    each
    for module in MODULES
    for each in vars(module).values()
    if hasattr(each, "signatures") and hasattr(each, "py_func")
]


def test_every_stage_of_the_method_is_run_and_has_a_budget() -> None:
    # The first time may also report the compilation of kernels.
    warm_up("direct", lambda _: None)
    stages: list[str] = []
    assert warm_up("direct", stages.append) > 0
    assert set(stages) == set(STAGE_BUDGETS_MS["direct"])


def compiled() -> list[tuple[str, list[object]]]:
    return [(kernel.py_func.__qualname__, list(kernel.signatures)) for kernel in KERNELS]


def all_that_may_happen() -> list[RgbdFrame]:
    """Still and rolling views, large rotations, darkness, and read-only arrays."""
    shared = add_noise(render_view(BRISK, 0.1), 3)
    shared.depth_raw.flags.writeable = False
    shared.color_bgr.flags.writeable = False
    aside = [
        MovingCamera(np.array([0.0, 0.0, 0.0, 0.0, angle_rad, 0.0]))
        for angle_rad in (0.2, 0.35, 0.5, 0.0)
    ]
    return [
        *render_sequence(BRISK, 3, readout_s=0.02, skew_s=0.01),
        *render_sequence(BRISK, 3),
        shared,
        *(replace(render_view(hand, 1.0), stamp_s=0.2 + k / 30) for k, hand in enumerate(aside)),
        replace(remove_color(add_noise(render_view(), 4)), stamp_s=0.5),
    ]


def frames_of_unknown_timing() -> list[RgbdFrame]:
    """Rolling views whose timing is searched for, and then learned."""
    views = render_sequence(BRISK, 16, readout_s=0.02)
    return [replace(view, readout_s=0.0, timing_prior=UNKNOWN_TIMING) for view in views]


def frames_of_known_timing() -> list[RgbdFrame]:
    """Rolling views whose timing is certain soon, so that the focal length is learned."""
    told = TimingPrior(0.0, 0.004, 0.002, TimingSource.CAMERA_FILE)
    views = render_sequence(BRISK, 16, readout_s=0.02)
    return [replace(view, timing_prior=told) for view in views]


def test_a_warm_method_compiles_nothing_for_real_frames() -> None:
    warm_up("direct", lambda _: None)
    stages: list[str] = []
    before = compiled()
    odometry = METHODS["direct"](MethodConfig(), StageReporter(stages.append))
    assert all(odometry.estimate(frame).ok for frame in all_that_may_happen())
    learning = METHODS["direct"](MethodConfig(), StageReporter(stages.append))
    assert all(learning.estimate(frame).ok for frame in frames_of_unknown_timing())
    learning = METHODS["direct"](MethodConfig(), StageReporter(stages.append))
    assert all(learning.estimate(frame).ok for frame in frames_of_known_timing())
    assert set(stages) == set(STAGE_BUDGETS_MS["direct"])
    assert KERNELS
    assert compiled() == before
