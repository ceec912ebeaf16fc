"""The warm-up compiles every kernel and reports every stage."""

from pathlib import Path

import numpy as np

from tests.vo_service.odometry.hand_held_sequence import render_elsewhere
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry import ransac
from vo_service.odometry.features import descriptor, detector, matching
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.surf import recovery
from vo_service.odometry.warm_up import second_process, warm_up
from vo_service.types.odometry import NullStageTimer


def test_every_stage_of_the_method_is_run_and_reported() -> None:
    stages: list[str] = []
    assert warm_up("surf", stages.append) > 0
    assert set(stages) == {"surf", "points", "match", "ransac", "svd", "verify", "recovery"}


def test_a_warm_sfm_compiles_nothing_for_a_real_frame() -> None:
    warm_up("surf", lambda _: None)
    kernels = [
        each
        for module in (recovery, matching, ransac, detector, descriptor)
        for each in vars(module).values()
        if hasattr(each, "signatures") and hasattr(each, "py_func")
    ]
    before = [list(kernel.signatures) for kernel in kernels]
    odometry = METHODS["surf"](MethodConfig(), NullStageTimer())
    for seq in range(2):
        odometry.estimate(render_corner(np.eye(4), seq))
    lost = odometry.estimate(render_elsewhere(2))
    assert not lost.ok
    assert kernels
    assert [list(kernel.signatures) for kernel in kernels] == before


def test_a_second_process_compiles_as_long_as_the_first() -> None:
    before = child_processes()
    with second_process("icp", is_needed=True):
        assert child_processes() > before
    assert child_processes() == before


def test_prepared_kernels_need_no_second_process() -> None:
    children: list[set[str]] = []
    warm_up("surf", lambda _: None)
    warm_up("surf", lambda _: children.append(child_processes()))
    assert set.union(*children) <= child_processes()


def child_processes() -> set[str]:
    own = Path("/proc/self/task")
    return {pid for task in own.iterdir() for pid in (task / "children").read_text().split()}
