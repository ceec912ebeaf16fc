"""`replay` of a recording with the odometry of wheels: used, repeatable, and kept."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.bag.bag_writer import EncodedMessage
from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.bag.odometry_messages import read_odometry_messages
from drivers.core.geometry import read_trajectory
from drivers.playback.camera import RecordingCamera
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.odometry import ODOMETRY_TOPIC
from drivers.ros_messages.navigation import ODOMETRY_SCHEMA
from tests.conftest import FRAMES
from tests.vo_service.cli.cli_runner import KinectVo
from tests.vo_service.wheel_odometry.wheel_driver import wheel_message
from vo_service.wheel_odometry.planar_pose import PlanarTwist

# The camera of the recording moves otherwise: where wheels are used, poses are others. As it also
# sees that, the wheels count as slipping.
DRIVE = PlanarTwist(0.5, 0.0, 0.0)
BLANK_FROM = 6


@pytest.fixture
def drive(recording: Path, tmp_path: Path) -> Path:
    """The recording with wheels, 50 messages a second; its last frames show nothing."""
    path = tmp_path / "drive.mcap"
    with (
        RecordingCamera(recording) as camera,
        FrameRecorder(McapRecordingFile(path, is_raw=True)) as recorder,
    ):
        for frame in camera:
            if frame.seq >= BLANK_FROM:
                frame.color_bgr[:], frame.depth_raw[:] = 0, 0
            recorder.write(frame, partial(recorder.file.write_messages, messages(frame.stamp_s)))
    return path


def messages(frame_s: float) -> list[EncodedMessage]:
    """Two messages of each frame."""
    stamps_s = (frame_s, frame_s + 0.02)
    return [
        EncodedMessage(
            ODOMETRY_TOPIC,
            ODOMETRY_SCHEMA,
            round(stamp_s * 1e9),
            wheel_message(stamp_s, DRIVE.motion(stamp_s), DRIVE),
        )
        for stamp_s in stamps_s
    ]


def replay(kinect_vo: KinectVo, drive: Path, name: str, *, has_wheels: bool = True) -> Path:
    config, trajectory = drive.parent / "kinect.toml", drive.parent / f"{name}.txt"
    enabled = str(has_wheels).lower()
    config.write_text(f"schema = 1\n[wheel_odometry]\nenabled = {enabled}\n")
    mcap = drive.parent / f"{name}.mcap"
    options = ("--config", config, "--no-publish", "--trajectory", trajectory, "--mcap", mcap)
    outcome = kinect_vo("replay", drive, *options)
    assert outcome.code == 0, outcome.err
    assert "no message" not in outcome.err
    return trajectory


def test_wheels_go_on_where_the_camera_sees_nothing(drive: Path, kinect_vo: KinectVo) -> None:
    without = read_trajectory(replay(kinect_vo, drive, "without", has_wheels=False))
    assert len(without) < FRAMES
    with_wheels = read_trajectory(replay(kinect_vo, drive, "with"))
    assert len(with_wheels) == FRAMES
    steps_m = np.diff(with_wheels.T_world_camera[BLANK_FROM:, :3, 3], axis=0)
    assert np.linalg.norm(steps_m, axis=1) == pytest.approx(DRIVE.forward_m_s / 30, abs=1e-3)


def test_a_replay_with_wheels_repeats_bit_for_bit_and_keeps_the_messages(
    drive: Path, kinect_vo: KinectVo
) -> None:
    one, other = replay(kinect_vo, drive, "one"), replay(kinect_vo, drive, "other")
    assert one.read_bytes() == other.read_bytes()
    kept = list(read_odometry_messages(drive.parent / "one.mcap", [ODOMETRY_TOPIC]))
    assert kept == list(read_odometry_messages(drive, [ODOMETRY_TOPIC]))[: len(kept)]
    assert len(kept) >= 20
