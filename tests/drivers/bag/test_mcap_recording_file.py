"""Recording into MCAP: its messages, and that it is whole after a crash or on a full disk."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

from drivers.bag import mcap_recording_file
from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import AccelerometerReading, RgbdFrame
from drivers.core import UserFacingError, write_errors
from drivers.core.geometry import Trajectory, rigid_transform
from drivers.playback.recording_formats import open_recording
from drivers.recording import frame_recorder
from drivers.recording.frame_recorder import FrameRecorder
from tests.drivers.conftest import make_frame
from tests.drivers.tum.read_recording import read_recording


def record(path: Path, frames: list[RgbdFrame], is_raw: bool = False) -> None:
    with FrameRecorder(McapRecordingFile(path, is_raw=is_raw)) as recorder:
        for frame in frames:
            recorder.write(frame)
    assert recorder.written == len(frames)


@pytest.mark.parametrize("depth_factor", [1000.0, 5000.0])
def test_without_raw_only_color_loses_a_little(tmp_path: Path, depth_factor: float) -> None:
    frame = make_frame(0, depth_factor=depth_factor)
    record(tmp_path / "a.mcap", [frame])
    (ours,) = read_recording(tmp_path / "a.mcap")
    np.testing.assert_array_equal(ours.depth_raw, frame.depth_raw)
    assert 0 < np.abs(ours.color_bgr.astype(int) - frame.color_bgr).mean() < 3


def test_other_programs_read_the_messages(tmp_path: Path) -> None:
    readings = (AccelerometerReading(999.9, (0.1, -9.7, 0.0)),)
    frame = make_frame(0, depth_factor=1000.0, gravity_m_s2=(0.0, 9.8, 0.0), accelerometer=readings)
    truth = Trajectory(np.array([1000.0]), rigid_transform(np.eye(3), [1.0, 2.0, 3.0])[None])
    with FrameRecorder(McapRecordingFile(tmp_path / "a.mcap"), truth) as recorder:
        recorder.write(frame)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        found = {
            connection.topic: reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
        }
    assert sorted(found) == [
        "/camera/camera_file",
        "/camera/depth_registered/image_raw",
        "/camera/frame_stamps",
        "/camera/gravity",
        "/camera/rgb/camera_info",
        "/camera/rgb/image_raw/compressed",
        "/ground_truth",
        "/ground_truth/path",
        "/imu",
        "/tf",
        "/tf_static",
    ]
    assert found["/camera/depth_registered/image_raw"].encoding == "16UC1"  # type: ignore[attr-defined]
    color: object = found["/camera/rgb/image_raw/compressed"]
    assert getattr(color, "format", "") == "bgr8; jpeg compressed bgr8"
    imu: object = found["/imu"]
    assert imu.linear_acceleration.y == -9.7  # type: ignore[attr-defined]
    assert imu.orientation_covariance[0] == -1  # type: ignore[attr-defined]


def test_ros_2_plays_what_is_written_once_for_late_subscribers(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", [make_frame(0)])
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        profiles = {each.topic: each.ext.offered_qos_profiles for each in reader.connections}  # type: ignore[union-attr]
    latched = {
        topic for topic, [qos] in profiles.items() if qos.durability.name == "TRANSIENT_LOCAL"
    }
    assert latched == {"/tf_static", "/camera/camera_file"}
    assert {qos.reliability.name for [qos] in profiles.values()} == {"RELIABLE"}


def test_ros_2_of_any_version_knows_how_to_read_the_quality_of_service(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", [make_frame(0)])
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        (rosbag2,) = reader.iter_metadata()
        summary = reader.get_summary()
    assert rosbag2.name == "rosbag2"
    metadata = YAML(typ="safe").load(rosbag2.metadata["serialized_metadata"])
    assert metadata["version"] < 9  # from 9 on it is read as words
    assert summary is not None
    for channel in summary.channels.values():
        (qos,) = YAML(typ="safe").load(channel.metadata["offered_qos_profiles"])
        names = ("history", "reliability", "durability", "liveliness")
        assert all(isinstance(qos[name], int) for name in names)


def test_each_reading_of_the_accelerometer_is_recorded_once_with_its_stamp(tmp_path: Path) -> None:
    gravity, readings = (
        (0.1, 9.7, 0.2),
        [AccelerometerReading(0.1 * k, (k, 0.0, 9.0)) for k in range(9)],
    )
    frames = [
        make_frame(
            k,
            stamp_s=0.11 + k / 30,
            gravity_m_s2=gravity,
            accelerometer=tuple(readings[: 2 + k // 3]),
        )
        for k in range(6)
    ]
    record(tmp_path / "a.mcap", frames)
    series = open_recording(tmp_path / "a.mcap").accelerometer
    np.testing.assert_allclose(series.stamps_s, [0.0, 0.1, 0.2])
    assert series.acceleration_m_s2[:, 0].tolist() == [0, 1, 2]
    assert [frame.gravity_m_s2 for frame in read_recording(tmp_path / "a.mcap")] == [gravity] * 6


def test_the_ground_truth_ends_after_the_last_frame(tmp_path: Path) -> None:
    truth = Trajectory(np.arange(990.0, 2000.0), np.tile(np.eye(4), (1010, 1, 1)))
    with FrameRecorder(McapRecordingFile(tmp_path / "a.mcap"), truth) as recorder:
        for k in range(2):
            recorder.write(make_frame(k, stamp_s=1000.0 + k / 30))
    read = open_recording(tmp_path / "a.mcap").ground_truth
    assert read is not None
    np.testing.assert_array_equal(read.stamps_s, np.arange(990.0, 1002.0))


def test_a_disk_that_fills_leaves_a_whole_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_recorder, "FLUSH_PERIOD_S", 0.0)
    free = iter([mcap_recording_file.RESERVED_BYTES] * 6)
    monkeypatch.setattr(write_errors, "free_disk_bytes", lambda _: next(free, 0))
    with pytest.raises(UserFacingError, match=r"the disk is full \(less than 0\.016 GB are left\)"):  # noqa: PT012, SIM117
        with FrameRecorder(McapRecordingFile(tmp_path / "a.mcap")) as recorder:
            for k in range(1000):
                recorder.write(make_frame(k))
    assert len(read_recording(tmp_path / "a.mcap")) == 6
    assert "cut off" not in open_recording(tmp_path / "a.mcap").summary
