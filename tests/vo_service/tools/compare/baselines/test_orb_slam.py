"""ORB-SLAM3 as a baseline: what it is told, and its poses where it is installed."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import pose_distance
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.folder import open_tum_folder
from drivers.tum.writer import TumFolder
from tests.vo_service.corner_sequence import corner_frames, corner_pose
from vo_service.tools.compare.baselines.orb_slam import OrbSlamFactory, format_settings
from vo_service.tools.compare.baselines.orb_vocabulary import VocabularyFile
from vo_service.tools.compare.baselines.registry import PYORBSLAM3
from vo_service.types.odometry import NullStageTimer

FRAMES = 6


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    with FrameRecorder(TumFolder(tmp_path / "corner")) as writer:
        for frame in corner_frames(FRAMES):
            writer.write(frame)
    return tmp_path / "corner"


def test_the_settings_have_the_camera_of_the_recording(recording: Path) -> None:
    settings = format_settings(open_tum_folder(recording, None).calibration, 25.0, 1000)
    values = dict(line.split(": ") for line in settings.splitlines() if ": " in line)
    assert (float(values["Camera1.fx"]), float(values["Camera1.cy"])) == (525.0, 239.5)
    assert int(values["ORBextractor.nFeatures"]) == 1000


def test_the_settings_of_a_run_name_the_vocabulary() -> None:
    trained = OrbSlamFactory(1000)
    given = OrbSlamFactory(1000, VocabularyFile(Path("/data/ORBvoc.txt"), "0123456789abcdef"))
    assert trained.settings["vocabulary"] == "trained from the recording (k = 10, L = 4)"
    assert given.settings["vocabulary"] == "ORBvoc.txt (sha256 0123456789ab)"
    assert pickle.loads(pickle.dumps(given)) == given


def test_it_tracks_where_it_is_installed(recording: Path) -> None:
    pytest.importorskip(PYORBSLAM3.module, reason=f"needs {PYORBSLAM3.install_command}")
    odometry = OrbSlamFactory(1000).make(NullStageTimer(), open_tum_folder(recording, None))
    estimates = [odometry.estimate(frame) for frame in corner_frames(FRAMES)]
    assert all(estimate.ok for estimate in estimates)
    distance_m, _ = pose_distance(estimates[-1].T_world_camera, corner_pose(FRAMES - 1))
    assert distance_m < 0.02
    assert np.isfinite(estimates[-1].T_world_camera).all()
