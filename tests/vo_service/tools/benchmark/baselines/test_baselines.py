"""The peers as they are: each follows a few views, and one that shows nothing is no crash."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.icp.depth_views import ROOM, add_noise, hand_held_pose, render_view
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.profiling import NullStageTimer
from vo_service.odometry.registry import FeatureConfig
from vo_service.tools.benchmark.baselines.registry import BASELINES, BaselineFactory

DEPTH_ALONE = ("cv2-depth", "open3d-icp", "small-gicp")
ALLOWED_M = 0.02


def view(name: str, seq: int) -> RgbdFrame:
    """Three bare planes for those who see depth alone, two textured ones for the others."""
    if name in DEPTH_ALONE:
        return add_noise(render_view(ROOM, hand_held_pose(seq), seq), seq)
    return render_corner(hand_held_pose(seq), seq)


@pytest.mark.parametrize("name", list(BASELINES))
def test_each_follows_a_few_views_and_fails_on_one_that_shows_nothing(name: str) -> None:
    package = BASELINES[name].package
    pytest.importorskip(package.module, reason=f"needs {package.install_command}")
    odometry = BaselineFactory(name, FeatureConfig()).make(NullStageTimer(), None)
    views = [view(name, seq) for seq in range(3)]
    estimates = [odometry.estimate(each) for each in views]
    assert all(e.ok for e in estimates)
    error_m = estimates[-1].T_world_camera[:3, 3] - hand_held_pose(2)[:3, 3]
    assert np.linalg.norm(error_m) < ALLOWED_M
    black, blind = np.zeros_like(views[0].color_bgr), np.zeros_like(views[0].depth_raw)
    assert not odometry.estimate(replace(views[0], color_bgr=black, depth_raw=blind)).ok


def test_a_peer_is_tried_out_beforehand_and_names_its_package() -> None:
    told: list[str] = []
    recipe = BaselineFactory("cv2-rgb-depth", FeatureConfig())
    recipe.prepare(told.append)
    assert told == ["cv2"]
    assert str(recipe.settings["package"]).startswith("opencv-python-headless 5")
    assert not recipe.uses_truth
    assert pickle.loads(pickle.dumps(recipe)) == recipe
