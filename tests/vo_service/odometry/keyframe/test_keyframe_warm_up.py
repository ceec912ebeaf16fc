"""Compiling ahead of time: whatever the dense odometry may need later has been run."""

import pkgutil
from dataclasses import replace
from importlib import import_module

import numpy as np

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.keyframe.rolling_views import (
    BRISK,
    Hand,
    dark,
    film,
    noisy,
    seen,
)
from vo_service.methods import METHODS, FeatureSettings
from vo_service.odometry import keyframe, matching, points, ransac
from vo_service.odometry.keyframe.budget import BUDGET_MS
from vo_service.odometry.surf import hessian, maxima, orientation
from vo_service.warm_up import StageNames, warm_up

OWN = [f"{keyframe.__name__}.{each.name}" for each in pkgutil.iter_modules(keyframe.__path__)]
MODULES = [*map(import_module, OWN), matching, points, ransac, hessian, maxima, orientation]
KERNELS = [
    each
    for module in MODULES
    for each in vars(module).values()
    if hasattr(each, "signatures") and hasattr(each, "py_func")
]


def test_every_stage_of_the_method_is_run_and_told_and_has_a_budget() -> None:
    told: list[str] = []
    assert warm_up("keyframe", told.append) > 0
    assert set(told) == set(BUDGET_MS)


def compiled() -> list[tuple[str, list[object]]]:
    return [(kernel.py_func.__qualname__, list(kernel.signatures)) for kernel in KERNELS]


def all_that_may_happen() -> list[RgbdFrame]:
    """Still, rolling, far aside and back, in the dark, and what is read alone."""
    shared = noisy(seen(BRISK, 0.1), 3)
    shared.depth_raw.flags.writeable = False
    shared.colour_bgr.flags.writeable = False
    aside = [
        Hand(np.array([0.0, 0.0, 0.0, 0.0, angle_rad, 0.0])) for angle_rad in (0.2, 0.4, 0.5, 0.0)
    ]
    return [
        *film(BRISK, 3, readout_s=0.02, skew_s=0.01),
        *film(BRISK, 3),
        shared,
        *(replace(seen(hand, 1.0), stamp_s=0.2 + k / 30) for k, hand in enumerate(aside)),
        replace(dark(seen()), stamp_s=0.5),
    ]


def test_a_warm_method_compiles_nothing_more_for_real_frames() -> None:
    warm_up("keyframe", lambda _: None)
    told: list[str] = []
    before = compiled()
    odometry = METHODS["keyframe"](FeatureSettings(), StageNames(told.append))
    assert all(odometry.estimate(frame).ok for frame in all_that_may_happen())
    assert set(told) == set(BUDGET_MS)
    assert KERNELS
    assert compiled() == before
