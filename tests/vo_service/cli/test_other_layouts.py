"""Recordings in the layouts of other benchmarks, through the commands."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers import SyntheticConfig
from drivers.camera import PinholeCamera
from drivers.core.geometry import nearest_indices
from drivers.registry import open_camera
from tests.drivers.layouts.layout_writers import WRITERS, Frame
from tests.vo_service.cli.cli_runner import KinectVo

pytestmark = pytest.mark.slow
FRAMES = 12
ICL_NUIM = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)


@pytest.fixture(scope="module")
def rendered() -> list[Frame]:
    """A rendered room, seen by a hand-held camera with ICL-NUIM's intrinsics."""
    config = SyntheticConfig(duration_s=FRAMES / 30, camera=ICL_NUIM)
    with open_camera("synthetic", synthetic=config) as camera:
        truth = camera.ground_truth
        assert truth is not None
        return [
            (
                frame.color_bgr,
                frame.depth_raw,
                truth.T_world_camera[nearest_indices(truth.stamps_s, np.array([frame.stamp_s]))[0]],
            )
            for frame in camera
        ]


@pytest.fixture
def icl_nuim(rendered: list[Frame], tmp_path: Path) -> Path:
    WRITERS["ICL-NUIM"](tmp_path / "icl", rendered)
    return tmp_path / "icl"


def test_a_scene_in_icl_nuims_layout_replays_with_the_right_trajectory(
    icl_nuim: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo("replay", icl_nuim, "--no-publish", "--json")
    assert outcome.code == 0, outcome.err
    assert "layout of ICL-NUIM: the benchmark's camera; depth factor 5000; stamps" in outcome.err
    figures = json.loads(outcome.out)
    assert (figures["frames"], figures["failed"]) == (FRAMES, 0)
    assert figures["matched"] == FRAMES - 1  # frame 0 has no true pose
    assert figures["ate_rmse_m"] < 0.003
    assert figures["rpe_frame_deg"] < 0.2


def test_a_converted_layout_gives_the_same_trajectory_and_evaluation(
    icl_nuim: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    found = []
    converted = kinect_vo("convert", icl_nuim, tmp_path / "tum")
    assert converted.out == f"{FRAMES} frames in {tmp_path / 'tum'} (folder)\n"
    assert "layout of ICL-NUIM" in converted.err
    for folder in (icl_nuim, tmp_path / "tum"):
        poses = tmp_path / f"{folder.name}.txt"
        kinect_vo("replay", folder, "--no-publish", "--trajectory", poses)
        evaluated = kinect_vo("evaluate", poses, folder, "--json")
        found.append((poses.read_bytes(), json.loads(evaluated.out)["ate_rmse_m"]))
    assert found[0][0] == found[1][0]
    assert found[0][1] == pytest.approx(found[1][1], abs=1e-6)


def test_seven_scenes_depth_is_registered_when_it_is_converted(
    rendered: list[Frame], tmp_path: Path, kinect_vo: KinectVo
) -> None:
    WRITERS["7-Scenes"](tmp_path / "scene", rendered[:2])
    converted = kinect_vo("convert", tmp_path / "scene", tmp_path / "tum")
    assert "uncalibrated depth registered by the usual geometry of a Kinect" in converted.err
    (depth_file, *_) = sorted((tmp_path / "tum/depth").iterdir())
    registered = cv2.imread(str(depth_file), cv2.IMREAD_UNCHANGED)
    assert registered is not None
    assert registered.max() < 65535
    assert "depth_factor = 1000.0" in (tmp_path / "tum/camera.toml").read_text()
