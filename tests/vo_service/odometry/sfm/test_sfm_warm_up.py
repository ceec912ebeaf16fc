"""Compiling ahead of time: what structure from motion needs has been run by the warm-up."""

from tests.vo_service.odometry.hand_held_sequence import estimate_all
from tests.vo_service.odometry.sfm.sideways_sequence import render_views
from vo_service.odometry import depth_planes
from vo_service.odometry.features import matching
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.sfm import bundle_adjustment
from vo_service.odometry.warm_up import warm_up
from vo_service.types.odometry import NullStageTimer

KERNELS = [
    each
    for module in (bundle_adjustment, matching, depth_planes)
    for each in vars(module).values()
    if hasattr(each, "signatures") and hasattr(each, "py_func")
]


def test_every_stage_is_run_and_reported() -> None:
    stages: list[str] = []
    assert warm_up("sfm", stages.append) > 0
    assert set(stages) == {"surf", "match", "ransac", "scale", "refine", "points"}


def test_a_warm_sfm_compiles_nothing_for_a_real_frame() -> None:
    warm_up("sfm", lambda _: None)
    before = [list(kernel.signatures) for kernel in KERNELS]
    estimates = estimate_all(METHODS["sfm"](MethodConfig(), NullStageTimer()), render_views(6))
    assert estimates[-1].ok
    assert KERNELS
    assert [list(kernel.signatures) for kernel in KERNELS] == before
