"""Each baseline tracks a few views and survives an empty one."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.icp.depth_views import ROOM, add_noise, hand_held_pose, render_view
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.tools.compare.baselines.frame_to_frame import make_baseline
from vo_service.tools.compare.baselines.registry import BASELINES, ORB_SLAM3, BaselineFactory
from vo_service.types.odometry import NullStageTimer

DEPTH_ONLY = ("cv2-depth", "open3d-icp", "small-gicp")
MAX_ERROR_M = 0.02


def render(name: str, seq: int) -> RgbdFrame:
    """Render three plain planes for depth-only methods, two textured ones for the others."""
    if name in DEPTH_ONLY:
        return add_noise(render_view(ROOM, hand_held_pose(seq), seq), seq)
    return render_corner(hand_held_pose(seq), seq)


@pytest.mark.parametrize("name", [name for name in BASELINES if name != ORB_SLAM3])
def test_each_tracks_a_few_views_and_fails_on_an_empty_one(name: str) -> None:
    package = BASELINES[name]
    pytest.importorskip(package.module, reason=f"needs {package.install_command}")
    odometry = make_baseline(name, package.load(), 1000, NullStageTimer())
    views = [render(name, seq) for seq in range(3)]
    estimates = [odometry.estimate(view) for view in views]
    assert all(e.ok for e in estimates)
    error_m = estimates[-1].T_world_camera[:3, 3] - hand_held_pose(2)[:3, 3]
    assert np.linalg.norm(error_m) < MAX_ERROR_M
    black, no_depth = np.zeros_like(views[0].color_bgr), np.zeros_like(views[0].depth_raw)
    assert not odometry.estimate(replace(views[0], color_bgr=black, depth_raw=no_depth)).ok


def test_a_baseline_is_warmed_up_and_names_its_package() -> None:
    stages: list[str] = []
    factory = BaselineFactory("cv2-rgb-depth", 1000)
    factory.prepare(stages.append)
    assert stages == ["cv2"]
    assert str(factory.settings["package"]).startswith("opencv-python-headless 5")
    assert not factory.uses_truth
    assert pickle.loads(pickle.dumps(factory)) == factory
