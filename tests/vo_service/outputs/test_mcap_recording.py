"""The MCAP file of a run: what it holds, what a replay takes from it, and faults of its disk."""

import json
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from drivers.camera import PlaybackMode
from drivers.core import InputError, UserFacingError, write_errors
from drivers.core.geometry import T_BODY_CAMERA, Trajectory, rigid_transform
from drivers.playback.camera import RecordingCamera
from drivers.playback.recording_formats import open_recording
from drivers.recording.odometry import OdometryRecord
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.wheel_odometry.wheel_driver import CURVE, pose_at, wheel_message
from tests.waiting import wait_until
from vo_service.config_tables import ScanConfig
from vo_service.navigation.frame_scans import FrameScans
from vo_service.outputs.mcap_recording import open_mcap_recording
from vo_service.types.messages import Status
from vo_service.types.occupancy_grid import FREE, NO_GRID, OCCUPIED, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

LOCKSTEP, REALTIME = PlaybackMode.LOCKSTEP, PlaybackMode.REALTIME


def record(path: Path, updates: list[OdometryUpdate], *statuses: Status, **options: Any) -> None:
    output = open_mcap_recording(path, LOCKSTEP, **options)
    for update in updates:
        output.on_update(update)
    for status in statuses:
        output.on_status(status)
    output.close()


def read_messages(path: Path) -> dict[str, list[Any]]:
    found = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return found


def test_each_frame_has_its_pose_state_and_timing(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(3)]
    updates[1] = replace(updates[1], state=TrackingState.LOST, reason="dark")
    record(tmp_path / "a.mcap", updates, STATUS)
    found = read_messages(tmp_path / "a.mcap")
    stamps_ns = [
        1_000_000_000 * m.header.stamp.sec + m.header.stamp.nanosec for m in found["/vo/odom"]
    ]
    assert stamps_ns == pytest.approx([1e9 * update.stamp_s for update in updates])
    position = found["/vo/odom"][2].pose.pose.position
    np.testing.assert_allclose([position.x, position.y, position.z], updates[2].T_odom_base[:3, 3])
    states = [json.loads(message.data) for message in found["/vo/state"]]
    assert [each["state"] for each in states] == ["tracking", "lost", "tracking"]
    assert [json.loads(each.data)["stamp_s"] for each in found["/camera/timing"]] == [
        update.stamp_s for update in updates
    ]
    (written,) = found["/vo/status"]
    assert json.loads(written.data)["reason"] == STATUS.reason


def test_transforms_lead_from_odom_to_the_camera_except_while_lost(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(3)]
    updates[1] = replace(updates[1], state=TrackingState.LOST)
    record(tmp_path / "a.mcap", updates)
    found = read_messages(tmp_path / "a.mcap")
    assert len(found["/tf"]) == 2
    (static,) = found["/tf_static"]
    names = [(each.header.frame_id, each.child_frame_id) for each in static.transforms]
    assert names == [("base_link", "camera_rgb_optical_frame")]
    rotation = static.transforms[0].transform.rotation
    np.testing.assert_allclose(np.abs([rotation.x, rotation.y, rotation.z, rotation.w]), 0.5)
    assert found["/tf"][0].transforms[0].header.frame_id == "odom"


def test_the_camera_is_mounted_as_told_though_a_planar_base_hides_a_bump(tmp_path: Path) -> None:
    mount = rigid_transform(T_BODY_CAMERA[:3, :3], (0.1, 0.0, 0.6))
    update, bump = make_update(0), rigid_transform(np.eye(3), (0.0, 0.0, 0.02))
    update = replace(update, T_odom_camera=bump @ update.T_odom_base @ mount)
    record(tmp_path / "a.mcap", [update], T_base_camera=mount)
    (static,) = read_messages(tmp_path / "a.mcap")["/tf_static"]
    place = static.transforms[0].transform.translation
    np.testing.assert_allclose([place.x, place.y, place.z], mount[:3, 3])


def test_the_ground_truth_begins_at_the_first_pose_of_each_epoch(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(4)]
    updates[2:] = [replace(each, epoch=2) for each in updates[2:]]
    stamps_s = np.array([each.frame.stamp_s for each in updates[1:]])  # none of the first frame
    truth = Trajectory(stamps_s, np.stack([rigid_transform(np.eye(3), [9.0, 0.0, 0.0])] * 3))
    record(tmp_path / "a.mcap", updates, ground_truth=lambda: truth)
    found = read_messages(tmp_path / "a.mcap")["/tf"]
    worlds = [[t for t in message.transforms if t.child_frame_id == "world"] for message in found]
    assert [len(each) for each in worlds] == [0, 1, 1, 1]
    shifts = [each.transform.translation.x for (each,) in worlds[1:]]
    turned = [update.T_odom_camera @ [-9.0, 0.0, 0.0, 1.0] for update in updates]
    assert shifts == pytest.approx([turned[1][0], turned[2][0], turned[2][0]])


def test_scans_of_each_frame_and_the_grid_on_change(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.array([[FREE, OCCUPIED]], np.int8), 0.05, (1.0, 2.0))
    updates = [replace(make_update(seq), grid=grid if seq else NO_GRID) for seq in range(3)]
    mount = rigid_transform(np.eye(3), (0.0, 0.0, 0.5)) @ T_BODY_CAMERA
    updates = [replace(each, T_odom_camera=each.T_odom_base @ mount) for each in updates]
    scans = FrameScans(ScanConfig(), mount)
    scans.load()
    updates = [scans.add_to(each) for each in updates]
    record(tmp_path / "a.mcap", updates)
    found = read_messages(tmp_path / "a.mcap")
    for message, update in zip(found["/scan"], updates, strict=True):
        scan = update.scan.message()
        assert scan is not None
        np.testing.assert_array_equal(message.ranges, scan.ranges_m)
        assert message.header.frame_id == "camera_scan"
    (written,) = found["/map"]
    np.testing.assert_array_equal(written.data, [FREE, OCCUPIED])
    assert written.header.frame_id == "map"
    children = [each.child_frame_id for each in found["/tf"][0].transforms]
    assert "camera_scan" in children
    recording = open_recording(tmp_path / "a.mcap")
    assert len(recording.frames.stamps_s) == 3


def test_a_scan_of_a_camera_on_the_floor_is_not_recorded(tmp_path: Path) -> None:
    scans = FrameScans(ScanConfig(), T_BODY_CAMERA)
    scans.load()
    record(tmp_path / "a.mcap", [scans.add_to(make_update(0))])
    found = read_messages(tmp_path / "a.mcap")
    assert "/scan" not in found
    assert "camera_scan" not in [each.child_frame_id for each in found["/tf"][0].transforms]


def test_the_path_grows_except_while_lost(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(40)]
    updates[5:35] = [replace(each, state=TrackingState.LOST) for each in updates[5:35]]
    record(tmp_path / "a.mcap", updates)
    paths = read_messages(tmp_path / "a.mcap")["/vo/path"]
    assert [each.width for each in paths] == [1, 6]
    assert {each.header.frame_id for each in paths} == {"odom"}


def test_a_replay_takes_the_frames_and_not_the_poses(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(3)]
    record(tmp_path / "a.mcap", updates)
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.frames.stamps_s.tolist() == [update.stamp_s for update in updates]
    assert recording.ground_truth is None
    truth = Trajectory(updates[0].frame.stamp_s + np.arange(2.0), np.stack([T_BODY_CAMERA] * 2))
    record(tmp_path / "b.mcap", updates, ground_truth=lambda: truth)
    read = open_recording(tmp_path / "b.mcap").ground_truth
    assert read is not None
    np.testing.assert_allclose(read.stamps_s, updates[0].stamp_s + np.arange(2.0), atol=1e-6)


def test_the_messages_of_the_wheels_are_recorded_and_played_again(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(3)]
    stamps_s = [update.stamp_s + 0.01 * k for update in updates for k in range(3)]
    payloads = [wheel_message(stamp_s, pose_at(stamp_s), CURVE) for stamp_s in stamps_s]
    waiting = [OdometryRecord(*each) for each in zip(stamps_s, payloads, strict=True)]

    def take() -> list[OdometryRecord]:
        return [waiting.pop(0) for _ in range(3)]

    record(tmp_path / "a.mcap", updates, wheel_messages=take)
    assert len(read_messages(tmp_path / "a.mcap")["/wheel_odom"]) == 9
    camera = RecordingCamera(tmp_path / "a.mcap")
    assert list(camera.recorded_odometry(["/wheel_odom"])) == payloads


def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record(path, [make_update(0)])
    before = path.read_bytes()
    with pytest.raises(InputError, match="cannot be written: File exists"):
        open_mcap_recording(path, LOCKSTEP)
    output = open_mcap_recording(path, REALTIME)
    output.on_update(make_update(0))
    output.close()
    assert (tmp_path / "a-0001.mcap").read_bytes() == before
    with pytest.raises(InputError, match=r"the file name must end in \.mcap"):
        open_mcap_recording(tmp_path / "a.bag", REALTIME)


def test_a_run_without_frames_leaves_no_file(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", [], STATUS)
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("frames_before", [0, 3])
def test_a_full_disk_is_a_warning_of_the_service_until_there_is_space(
    frames_before: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("drivers.recording.frame_recorder.FLUSH_PERIOD_S", 0.0)
    monkeypatch.setattr("vo_service.outputs.write_fault.RETRY_PERIOD_S", 0.0)
    path, numbers = tmp_path / "a.mcap", count()
    disk = {"free": 10**12 if frames_before else 0}
    monkeypatch.setattr(write_errors, "free_disk_bytes", lambda _: disk["free"])
    output = open_mcap_recording(path, REALTIME)

    def send_until(condition: Callable[[], bool]) -> None:
        def has_come() -> bool:
            output.on_update(make_update(next(numbers)))
            return condition()

        wait_until(has_come)

    if frames_before:
        send_until(lambda: path.exists() and path.stat().st_size > 10_000)
    disk["free"] = 0
    send_until(lambda: "a.mcap: the disk is full (less than 1" in output.warning)
    disk["free"] = 10**12
    send_until(lambda: output.warning == "" and path.exists())
    with pytest.raises(UserFacingError, match=r"a\.mcap: the recording is incomplete"):
        output.close()
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    for file in [path, tmp_path / "a-0001.mcap"][: 2 if frames_before else 1]:
        assert open_recording(file).frames.pairs
