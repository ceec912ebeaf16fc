"""The warm-up compiles every kernel and reports every stage."""

import sys
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.hand_held_sequence import render_elsewhere
from tests.vo_service.odometry.icp.depth_views import ROOM, add_noise, hand_held_pose, render_view
from tests.vo_service.odometry.sfm.sideways_sequence import render_views
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.warm_up import warm_up
from vo_service.types.odometry import NullStageTimer


def icp_frames() -> list[RgbdFrame]:
    frames = [add_noise(render_view(ROOM, hand_held_pose(k), k), k) for k in range(2)]
    # A frame that another process shares may be read alone.
    frames[1].depth_raw.flags.writeable = False
    return [*frames, render_view(ROOM[:1], np.eye(4), 2)]


def surf_frames() -> list[RgbdFrame]:
    return [*(render_corner(np.eye(4), seq) for seq in range(2)), render_elsewhere(2)]


# The frames of each method, the last of which is lost except with sfm, and its stages.
CASES: dict[str, tuple[Callable[[], list[RgbdFrame]], str]] = {
    "surf": (surf_frames, "surf points match ransac svd verify recovery"),
    "icp": (icp_frames, "pyramid planes align retry"),
    "sfm": (partial(render_views, 6), "surf match ransac scale refine points"),
}


def compiled_kernels() -> dict[tuple[str, str], int]:
    """Number of compiled signatures of each kernel of the odometry that has been imported."""
    return {
        (name, key): len(each.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith("vo_service.odometry")
        for key, each in vars(module).items()
        if hasattr(each, "signatures") and hasattr(each, "py_func")
    }


@pytest.mark.parametrize("method", CASES)
def test_the_warm_up_reports_every_stage_and_compiles_all_for_real_frames(method: str) -> None:
    make_frames, stages = CASES[method]
    reported: list[str] = []
    assert warm_up(method, reported.append) > 0
    assert set(reported) >= set(stages.split())
    frames = make_frames()
    before = compiled_kernels()
    odometry = METHODS[method](MethodConfig(), NullStageTimer())
    is_good = [odometry.estimate(frame).ok for frame in frames]
    assert is_good[-1] is (method == "sfm")
    assert before
    assert compiled_kernels() == before
