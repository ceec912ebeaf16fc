"""The peers as they are: each follows a few views, and one that shows nothing is no crash."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.icp.views import ROOM, noisy, pose, view_of
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.bench.peers.catalogue import PEERS
from vo_service.bench.peers.recipe import PeerRecipe
from vo_service.methods import FeatureSettings
from vo_service.odometry.stopwatch import NullStopwatch

DEPTH_ALONE = ("cv2-depth", "open3d-icp", "small-gicp")
ALLOWED_M = 0.02


def view(name: str, seq: int) -> RgbdFrame:
    """Three bare planes for those who see depth alone, two textured ones for the others."""
    if name in DEPTH_ALONE:
        return noisy(view_of(ROOM, pose(seq), seq), seq)
    return view_of_a_corner(pose(seq), seq)


@pytest.mark.parametrize("name", list(PEERS))
def test_each_follows_a_few_views_and_fails_on_one_that_shows_nothing(name: str) -> None:
    package = PEERS[name].package
    pytest.importorskip(package.module, reason=f"needs {package.how_to_install}")
    odometry = PeerRecipe(name, FeatureSettings()).make(NullStopwatch(), None)
    views = [view(name, seq) for seq in range(3)]
    estimates = [odometry.estimate(each) for each in views]
    assert all(e.ok for e in estimates)
    error_m = estimates[-1].T_world_camera[:3, 3] - pose(2)[:3, 3]
    assert np.linalg.norm(error_m) < ALLOWED_M
    black, blind = np.zeros_like(views[0].colour_bgr), np.zeros_like(views[0].depth_raw)
    assert not odometry.estimate(replace(views[0], colour_bgr=black, depth_raw=blind)).ok


def test_a_peer_is_tried_out_beforehand_and_names_its_package() -> None:
    told: list[str] = []
    recipe = PeerRecipe("cv2-rgb-depth", FeatureSettings())
    recipe.prepare(told.append)
    assert told == ["cv2"]
    assert str(recipe.settings["package"]).startswith("opencv-python-headless 5")
    assert not recipe.uses_truth
    assert pickle.loads(pickle.dumps(recipe)) == recipe
