"""Compiling ahead of time: every kernel, every stage told."""

import numpy as np

from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from tests.vo_service.odometry.walk import elsewhere
from vo_service.methods import METHODS, FeatureSettings
from vo_service.odometry import guided_matching, matching, ransac
from vo_service.odometry.stopwatch import NullStopwatch
from vo_service.odometry.surf import hessian, maxima, orientation
from vo_service.warm_up import warm_up


def test_every_stage_of_the_method_is_run_and_told() -> None:
    told: list[str] = []
    assert warm_up("surf", told.append) > 0
    assert set(told) == {"surf", "points", "match", "ransac", "svd", "recovery"}


def test_a_warm_method_compiles_nothing_more_for_a_real_frame() -> None:
    warm_up("surf", lambda _: None)
    kernels = [
        each
        for module in (guided_matching, matching, ransac, hessian, maxima, orientation)
        for each in vars(module).values()
        if hasattr(each, "signatures") and hasattr(each, "py_func")
    ]
    before = [list(kernel.signatures) for kernel in kernels]
    odometry = METHODS["surf"](FeatureSettings(), NullStopwatch())
    for seq in range(2):
        odometry.estimate(view_of_a_corner(np.eye(4), seq))
    lost = odometry.estimate(elsewhere(2))
    assert not lost.ok
    assert kernels
    assert [list(kernel.signatures) for kernel in kernels] == before
