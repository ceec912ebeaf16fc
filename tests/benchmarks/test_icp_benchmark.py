import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks.icp import OPENCV, OURS, OURS_FRAME_TO_FRAME, make_methods
from tests.forked_process import run_module
from tests.vo_service.odometry.icp.depth_views import (
    CAMERA,
    ROOM,
    add_noise,
    hand_held_pose,
    make_frame,
    render_view,
)

pytestmark = pytest.mark.subprocess


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run_module("benchmarks", "icp", *arguments)


def test_every_method_is_measured(recording: Path) -> None:
    result = run(str(recording), "--frame-to-frame", "--json")
    assert result.returncode == 0, result.stderr
    results = json.loads(result.stdout)[str(recording)]
    assert list(results) == [OURS, OURS_FRAME_TO_FRAME, OPENCV]
    assert all(result["frames"] == 12 and result["cpu_ms"] > 0 for result in results.values())


def test_a_missing_open3d_is_an_error_with_the_install_command(tmp_path: Path) -> None:
    result = run(str(tmp_path), "--open3d", str(tmp_path / "nothing"))
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1
    assert "pip install --target" in result.stderr


@pytest.mark.parametrize("name", [OURS, OURS_FRAME_TO_FRAME, OPENCV])
def test_each_tracks_a_corner_of_a_room_and_fails_without_depth(name: str) -> None:
    odometry = make_methods(None, frame_to_frame=True)[name]()
    blind = make_frame(np.zeros((CAMERA.height, CAMERA.width)), 2)
    frames = [add_noise(render_view(ROOM, hand_held_pose(k), k), k) for k in (0, 1)]
    estimates = [
        odometry.estimate(f) for f in (*frames, blind, render_view(ROOM, hand_held_pose(2), 2))
    ]
    assert [e.ok for e in estimates] == [True, True, False, True]
    error = estimates[-1].T_world_camera[:3, 3] - hand_held_pose(2)[:3, 3]
    assert np.linalg.norm(error) < 0.02
