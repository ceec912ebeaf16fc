"""The flight recorder: incidents on loss and on command, and its second process."""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import PinholeCamera
from drivers.core.geometry import read_trajectory
from tests.drivers.tum.read_recording import read_recording
from tests.resource_leaks import resources_in_use
from tests.vo_service.outputs.recorder.recorder_inputs import (
    SMALL,
    incident_of,
    list_incidents,
    make_frame,
    make_recorder_status,
    make_update,
    running_recorder,
    save_incident,
    send_updates,
    wait_for_incident,
)
from tests.vo_service.outputs.sample_updates import CAMERA
from tests.waiting import wait_until
from vo_service.types.odometry_update import TrackingState

pytestmark = pytest.mark.subprocess

LOST = TrackingState.LOST


def test_a_command_saves_the_last_frames_as_a_folder_that_replays_bit_for_bit(
    tmp_path: Path,
) -> None:
    folder = incident_of(tmp_path, *map(make_update, range(8)))
    assert list_incidents(tmp_path) == [folder]
    for seq, found in enumerate(read_recording(folder)):
        assert found.stamp_s == make_frame(seq).stamp_s
        assert found.skew_s == pytest.approx(make_frame(seq).skew_s)
        assert found.readout_s == make_frame(seq).readout_s
        assert found.gravity_m_s2 == pytest.approx(make_frame(seq).gravity_m_s2)
        assert found.camera == make_frame(seq).camera
        np.testing.assert_array_equal(found.color_bgr, make_frame(seq).color_bgr)
        np.testing.assert_array_equal(found.depth_raw, make_frame(seq).depth_raw)
    assert seq == 7


def test_an_incident_has_the_poses_and_statuses_of_the_service(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        recorder.on_status(make_recorder_status(frames=5))
        send_updates(recorder, *map(make_update, range(4)), make_update(4, LOST))
        folder = save_incident(recorder, "command")
    lines = (folder / "poses.jsonl").read_text().splitlines()
    poses_json = [json.loads(line) for line in lines]
    assert [pose["state"] for pose in poses_json] == ["tracking"] * 4 + ["lost"]
    assert poses_json[4]["reason"] == "too few matches"
    poses = read_trajectory(folder / "trajectory.txt")  # of the frames that have one
    np.testing.assert_allclose(poses.T_world_camera[:, 0, 3], [0.0, 0.01, 0.02, 0.03])
    (status,) = map(json.loads, (folder / "status.jsonl").read_text().splitlines())
    assert status["tracking"]["frames"] == 5
    assert status["unix_s"] == pytest.approx(time.time(), abs=100.0)
    assert status["recorder"]["limited_by"] == "seconds"


def test_frames_and_poses_of_a_live_camera_have_the_published_stamps(
    tmp_path: Path,
) -> None:
    folder = incident_of(tmp_path, *(make_update(seq, offset_s=1000.0) for seq in range(3)))
    stamps_s = [found.stamp_s for found in read_recording(folder)]
    assert stamps_s == pytest.approx(
        [make_update(seq).stamp_s + 1000.0 for seq in range(3)], abs=1e-6
    )
    np.testing.assert_allclose(read_trajectory(folder / "trajectory.txt").stamps_s, stamps_s)
    summary = json.loads((folder / "incident.json").read_text())
    assert summary["stamp_minus_camera_stamp_s"] == pytest.approx(1000.0)
    assert summary["frames"] == 3
    assert summary["about"] == {"versions": {"kinect-vo": "1"}}


def test_a_clock_that_is_set_back_breaks_neither_frames_nor_poses(tmp_path: Path) -> None:
    folder = incident_of(tmp_path, make_update(0), make_update(1), make_update(2, offset_s=-3600.0))
    assert len(read_recording(folder)) == len(read_trajectory(folder / "trajectory.txt")) == 3


def test_only_the_last_seconds_are_written(tmp_path: Path) -> None:
    short = replace(SMALL, seconds=0.51)
    folder = incident_of(tmp_path, *map(make_update, range(30)), settings=short)
    stamps_s = [found.stamp_s for found in read_recording(folder)]
    assert stamps_s == pytest.approx([make_update(seq).stamp_s for seq in range(14, 30)], abs=1e-6)


def test_only_frames_of_the_last_camera_are_written(tmp_path: Path) -> None:
    other = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    cameras = (CAMERA, CAMERA, other, other)
    updates = [make_update(seq, camera=camera) for seq, camera in enumerate(cameras)]
    folder = incident_of(tmp_path, *updates)
    assert [found.camera for found in read_recording(folder)] == [other] * 2


def test_an_incident_of_a_loss_includes_the_second_after_it(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        send_updates(
            recorder, *map(make_update, range(4)), make_update(4, LOST), make_update(5, LOST)
        )
        assert list_incidents(tmp_path) == []

        def next_status() -> bool:
            recorder.on_status(make_recorder_status())
            return bool(list_incidents(tmp_path))

        wait_until(next_status, "the loss to be due")
        assert len(read_recording(wait_for_incident(tmp_path, "lost"))) == 6


def test_a_loss_just_before_the_end_is_written(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, make_update(0), make_update(1, LOST))
    assert len(read_recording(wait_for_incident(tmp_path, "lost"))) == 2


def test_incidents_of_losses_can_be_disabled(tmp_path: Path) -> None:
    with running_recorder(tmp_path, replace(SMALL, save_on_loss=False)) as recorder:
        send_updates(recorder, make_update(0), make_update(1, LOST))
    assert list_incidents(tmp_path) == []


def test_a_clean_exit_writes_nothing(tmp_path: Path) -> None:
    with running_recorder(tmp_path):
        pass  # what is loaded once stays
    before = resources_in_use()
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, *map(make_update, range(4)))
    assert resources_in_use() <= before
    assert list(tmp_path.iterdir()) == []


def test_everything_is_private(tmp_path: Path) -> None:
    folder = incident_of(tmp_path, make_update(0))
    modes = {(path.is_dir(), path.stat().st_mode & 0o777) for path in folder.parent.rglob("*")}
    assert modes == {(True, 0o700), (False, 0o600)}


def test_a_due_incident_is_written_despite_another_setting(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, make_update(0), make_update(1, LOST))
        recorder.configure(replace(SMALL, total_mb=1000))
    assert len(read_recording(wait_for_incident(tmp_path, "lost"))) == 2


def test_too_many_incidents_are_not_kept(tmp_path: Path) -> None:
    settings = replace(SMALL, total_mb=1, folder=tmp_path / "elsewhere")
    large = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
    with running_recorder(tmp_path, settings) as recorder:
        send_updates(recorder, make_update(0, camera=large), make_update(1, camera=large))
        for reason in ("first", "second", "third"):
            save_incident(recorder, reason)
    names = sorted(path.name for path in (tmp_path / "elsewhere").iterdir())
    assert len(names) == 1
    assert names[0].endswith("third")


def test_quota_and_save_on_loss_can_change_at_run_time(
    tmp_path: Path,
) -> None:
    large = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, *(make_update(seq, camera=large) for seq in range(4)))
        save_incident(recorder, "first")
        recorder.configure(replace(SMALL, total_mb=1, save_on_loss=False))
        send_updates(recorder, make_update(4, LOST, camera=large))
        save_incident(recorder, "second")
    assert [path.name[-6:] for path in list_incidents(tmp_path)] == ["second"]
