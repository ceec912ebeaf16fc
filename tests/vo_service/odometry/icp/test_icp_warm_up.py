"""The warm-up compiles all kernels of ICP."""

import numpy as np

from tests.vo_service.odometry.icp.depth_views import ROOM, add_noise, hand_held_pose, render_view
from vo_service.odometry.icp import depth_pyramid, planes, residuals
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.warm_up import warm_up
from vo_service.types.odometry import NullStageTimer

KERNELS = [
    each
    for module in (planes, depth_pyramid, residuals)
    for each in vars(module).values()
    if hasattr(each, "signatures") and hasattr(each, "py_func")
]


def test_every_stage_is_run_and_reported() -> None:
    stages: list[str] = []
    assert warm_up("icp", stages.append) > 0
    assert set(stages) == {"pyramid", "planes", "align", "retry"}


def test_a_warm_icp_compiles_nothing_for_a_real_frame() -> None:
    warm_up("icp", lambda _: None)
    before = [list(kernel.signatures) for kernel in KERNELS]
    odometry = METHODS["icp"](MethodConfig(), NullStageTimer())
    frames = [add_noise(render_view(ROOM, hand_held_pose(k), k), k) for k in range(2)]
    # A frame that another process shares may be read alone.
    frames[1].depth_raw.flags.writeable = False
    assert all(odometry.estimate(frame).ok for frame in frames)
    assert not odometry.estimate(render_view(ROOM[:1], np.eye(4), 2)).ok
    assert KERNELS
    assert [list(kernel.signatures) for kernel in KERNELS] == before
