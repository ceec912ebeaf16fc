"""Recording on command: every frame from start to stop, into a named folder."""

import logging
import os
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import PinholeCamera
from drivers.core.process.record_ring import RecordRingReader, RecordRingWriter
from drivers.recording.odometry import OdometryRecord
from drivers.tum.odometry import read_odometry
from tests.drivers.tum.read_recording import read_recording
from tests.resource_leaks import child_pids
from tests.vo_service.outputs.recorder.recorder_inputs import (
    SMALL,
    command_error,
    make_frame,
    make_update,
    running_recorder,
    save_incident,
    send_updates,
)
from tests.waiting import wait_until
from vo_service.frame_packing import write_frame
from vo_service.outputs.recorder import worker as recording_module
from vo_service.outputs.recorder.messages import RecordingResult
from vo_service.outputs.recorder.worker import RecordingWriter

pytestmark = pytest.mark.subprocess


def has_written(folder: Path, frames: int) -> bool:
    """Return whether a recording holds this many frames."""
    return len(list(folder.glob("depth/[!.]*"))) >= frames


def test_every_frame_between_start_and_stop_is_recorded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, *map(make_update, range(3)))
        folder = Path(recorder.start_recording("desk"))
        assert recorder.recording == str(folder) == str(tmp_path / "recordings" / "desk")
        send_updates(recorder, *map(make_update, range(3, 9)))
        assert recorder.stop_recording() == str(folder)
        # A frame before its end may still be recorded.
        wait_until(lambda: f"{folder}: 6 frames, 0 missed" in caplog.text)
        send_updates(recorder, make_update(9))
    assert recorder.recording == recorder.warning == ""
    found = read_recording(folder)
    assert [f.stamp_s for f in found] == pytest.approx(
        [make_frame(n).stamp_s for n in range(3, 9)], abs=1e-6
    )
    for seq, frame in enumerate(found, 3):  # depth is exact; color is JPEG
        np.testing.assert_array_equal(frame.depth_raw, make_frame(seq).depth_raw)


def test_the_messages_of_the_wheels_are_recorded_and_in_incidents(tmp_path: Path) -> None:
    def message(number: int) -> OdometryRecord:
        return OdometryRecord(100.0 + number, b"%04d" % number * 180)

    sent = iter([[message(2 * k), message(2 * k + 1)] for k in range(5)])
    with running_recorder(tmp_path, wheel_messages=lambda: next(sent)) as recorder:
        folder = Path(recorder.start_recording("drive"))
        send_updates(recorder, *map(make_update, range(5)))
        recorder.stop_recording()
        incident = save_incident(recorder, "command")
    for each in (folder, incident):
        assert list(read_odometry(each)) == [message(k).message for k in range(10)]


def test_of_a_flood_of_messages_the_newest_are_recorded(tmp_path: Path) -> None:
    flood = [OdometryRecord(float(k), b"%04d" % k * 180) for k in range(1000)]
    with running_recorder(tmp_path, wheel_messages=lambda: flood) as recorder:
        folder = Path(recorder.start_recording("drive"))
        send_updates(recorder, *map(make_update, range(2)))
    kept = list(read_odometry(folder))
    assert kept[-1] == flood[-1].message
    assert 20 <= len(kept) <= 50


def test_more_frames_than_the_ring_holds_are_recorded(tmp_path: Path) -> None:
    with running_recorder(tmp_path, replace(SMALL, seconds=0.5)) as recorder:
        folder = Path(recorder.start_recording("long"))
        for begin in range(0, 60, 10):
            send_updates(recorder, *map(make_update, range(begin, begin + 10)))
            wait_until(partial(has_written, folder, begin + 5))
        recorder.stop_recording()
    assert len(read_recording(folder)) == 60


def test_closing_the_service_completes_a_recording(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        folder = Path(recorder.start_recording("desk"))
        send_updates(recorder, *map(make_update, range(4)))
    assert len(read_recording(folder)) == 4


def test_a_recording_without_a_frame_creates_no_folder_and_says_so(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        folder = recorder.start_recording("nothing")
        assert "no frame has arrived since its start" in command_error(recorder.stop_recording)
        assert recorder.start_recording("nothing") == folder
    assert not Path(folder).exists()


def test_a_name_that_is_taken_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "recordings" / "old").mkdir(parents=True)
    with running_recorder(tmp_path) as recorder:
        assert "a recording 'old' exists" in command_error(lambda: recorder.start_recording("old"))
        folder = recorder.start_recording("new")
        assert folder in command_error(lambda: recorder.start_recording("newer"))


def test_another_camera_ends_the_recording_with_a_reason(tmp_path: Path) -> None:
    other = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    with running_recorder(tmp_path) as recorder:
        folder = Path(recorder.start_recording("desk"))
        send_updates(recorder, make_update(0), make_update(1), make_update(2, camera=other))
        wait_until(lambda: recorder.recording == "")
        assert "the camera changed during recording" in recorder.warning
    assert len(read_recording(folder)) == 2


def test_a_dead_recorder_process_ends_the_recording_with_a_reason(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        folder = Path(recorder.start_recording("desk"))
        send_updates(recorder, *map(make_update, range(4)))
        wait_until((folder / "associations.txt").exists)
        (child,) = child_pids()
        os.kill(child, signal.SIGKILL)
        wait_until(lambda: recorder.recording == "")
        assert recorder.warning == f"recorder: its process ended and cut off {folder}"


class _Ring:
    """A ring in this process, and recordings of it."""

    def __init__(self, folder: Path) -> None:
        self.results: list[RecordingResult] = []
        self.writer = RecordRingWriter("trial", 0.2, 1 << 22)
        self.reader = RecordRingReader(self.writer.memory)
        self.folder = folder

    def record(self, frames: int) -> RecordingResult:
        """Fill the ring, then record it; return the result."""
        for seq in range(frames):
            write_frame(self.writer, make_update(seq))
        RecordingWriter(self.reader, 0, self.folder, self.results.append).stop(frames)
        return self.results[-1]


def test_frames_overwritten_before_they_are_written_are_counted(
    tmp_path: Path,
) -> None:
    result = _Ring(tmp_path / "slow").record(frames=40)
    assert result.error == ""
    assert 0 < result.frame_count < 40
    assert result.frame_count + result.missed_frames == 40
    assert len(read_recording(result.folder)) == result.frame_count


def test_low_disk_space_ends_a_recording_with_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_module, "MIN_FREE_BYTES", 10**18)
    result = _Ring(tmp_path / "full").record(frames=2)
    assert result.frame_count == 0
    assert "are left); free some space" in result.error
    assert not result.folder.exists()
