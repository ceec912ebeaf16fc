"""Compiling ahead of time: what structure from motion needs has been run by the warm-up."""

from tests.vo_service.odometry.sfm.sideways import render_views
from tests.vo_service.odometry.walk import estimate_all
from vo_service.methods import METHODS, FeatureConfig
from vo_service.odometry import matching, points
from vo_service.odometry.sfm import bundle_kernels
from vo_service.odometry.stopwatch import NullStageTimer
from vo_service.warm_up import warm_up

KERNELS = [
    each
    for module in (bundle_kernels, matching, points)
    for each in vars(module).values()
    if hasattr(each, "signatures") and hasattr(each, "py_func")
]


def test_every_stage_is_run_and_told() -> None:
    told: list[str] = []
    assert warm_up("sfm", told.append) > 0
    assert set(told) == {"surf", "match", "ransac", "scale", "refine", "points"}


def test_a_warm_method_compiles_nothing_more_for_a_real_frame() -> None:
    warm_up("sfm", lambda _: None)
    before = [list(kernel.signatures) for kernel in KERNELS]
    estimates = estimate_all(METHODS["sfm"](FeatureConfig(), NullStageTimer()), render_views(6))
    assert estimates[-1].ok
    assert KERNELS
    assert [list(kernel.signatures) for kernel in KERNELS] == before
