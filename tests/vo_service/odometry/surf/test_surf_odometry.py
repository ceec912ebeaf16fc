import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera import PlaybackMode, RgbdFrame
from drivers.playback.camera import RecordingCamera
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all, hand_held_poses
from tests.vo_service.odometry.recording_stage_timer import RecordingStageTimer
from tests.vo_service.odometry.surf.trajectory_digest import trajectory_digest
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.types.estimate import Estimate


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [render_corner(T, seq) for seq, T in enumerate(hand_held_poses(6))]


def test_a_camera_in_a_known_scene_is_tracked(views: list[RgbdFrame]) -> None:
    poses = hand_held_poses(len(views))
    for k, estimate in enumerate(estimate_all(SurfOdometry(), views)):
        assert estimate.ok, estimate.reason
        assert_close(estimate.T_world_camera, poses[k], 0.002 * (1 + k), 0.1 * (1 + k))


@pytest.mark.subprocess
def test_the_number_of_threads_does_not_change_a_bit() -> None:
    script = str(Path(__file__).with_name("trajectory_digest.py"))
    root = str(Path(__file__).parents[4])
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2", "PYTHONPATH": root}
    run = subprocess.run(
        [sys.executable, script, "2"],
        env=environment, capture_output=True, text=True, check=True, timeout=100,
    )  # fmt: skip
    assert cv2.getNumThreads() == 1  # and OpenBLAS has one in the tests
    assert run.stdout.strip() == trajectory_digest()


def test_a_camera_at_rest_has_no_motion(views: list[RgbdFrame]) -> None:
    estimates = estimate_all(SurfOdometry(), [views[0]] * 4)
    assert all(e.ok for e in estimates)
    np.testing.assert_allclose(estimates[-1].T_world_camera, np.eye(4), atol=1e-12)


def test_upright_features_also_work(views: list[RgbdFrame]) -> None:
    estimates = estimate_all(SurfOdometry(SurfExtractor(500, upright=True)), views)
    assert all(e.ok for e in estimates)
    assert_close(estimates[-1].T_world_camera, hand_held_poses(6)[5], 0.012, 0.6)


def test_every_stage_is_timed_in_the_papers_order(views: list[RgbdFrame]) -> None:
    stopwatch = RecordingStageTimer()
    odometry = SurfOdometry(timer=stopwatch)
    estimate_all(odometry, views[:2])
    assert stopwatch.names == [
        "surf",
        "points",
        "surf",
        "points",
        "match",
        "ransac",
        "svd",
        "verify",
    ]


def recorded(folder: Path, frames: int) -> list[Estimate]:
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        odometry = SurfOdometry()
        return [odometry.estimate(frame) for frame in islice(camera, frames)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frames"),
    [("freiburg1_xyz_head", 10), ("freiburg1_desk_piece", 9), ("redkitchen", 100)],
)
def test_a_real_kinect_is_tracked_in_every_frame(recordings: Path, name: str, frames: int) -> None:
    estimates = recorded(recordings / name, frames)
    assert len(estimates) == frames
    assert [e.reason for e in estimates if not e.ok] == []
    assert min(e.inliers for e in estimates[1:]) > 50
