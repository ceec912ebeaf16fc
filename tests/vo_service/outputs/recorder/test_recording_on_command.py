"""Recording on command: every frame from then until told to stop, into a folder of a name."""

import logging
import os
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import PinholeCamera
from drivers.core.shared_frames.depth_packing import pack_depth
from drivers.core.shared_frames.record_ring import RecordRingReader, RecordRingWriter
from tests.drivers.tum.read_recording import read_recording
from tests.resource_leaks import child_pids
from tests.vo_service.outputs.recorder.recorder_inputs import (
    command_error,
    make_frame,
    make_update,
    running_recorder,
    send_updates,
)
from tests.waiting import wait_until
from vo_service.config_tables import RecorderConfig
from vo_service.frame_record import write_frame
from vo_service.outputs.recorder import recording_writer as recording_module
from vo_service.outputs.recorder.messages import RecordingResult
from vo_service.outputs.recorder.recording_writer import RecordingWriter

pytestmark = pytest.mark.subprocess

SMALL = RecorderConfig(max_mb=20)


def has_written(folder: Path, frames: int) -> bool:
    """Whether a recording holds so many."""
    return len(list(folder.glob("depth/[!.]*"))) >= frames


def test_every_frame_from_start_to_stop_is_recorded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    with running_recorder(tmp_path, SMALL) as opened:
        send_updates(opened, *map(make_update, range(3)))
        folder = Path(opened.start_recording("desk"))
        assert opened.recording == str(folder) == str(tmp_path / "recordings" / "desk")
        send_updates(opened, *map(make_update, range(3, 9)))
        assert opened.stop_recording() == str(folder)
        # A frame before its end may still be recorded.
        wait_until(lambda: f"{folder}: 6 frames, 0 missed" in caplog.text)
        send_updates(opened, make_update(9))
    assert opened.recording == opened.warning == ""
    found = read_recording(folder)
    assert [f.stamp_s for f in found] == pytest.approx(
        [make_frame(n).stamp_s for n in range(3, 9)], abs=1e-6
    )
    for seq, each in enumerate(found, 3):  # depth is exact; color is JPEG
        np.testing.assert_array_equal(each.depth_raw, make_frame(seq).depth_raw)


def test_more_frames_than_the_ring_holds_are_recorded(tmp_path: Path) -> None:
    with running_recorder(tmp_path, replace(SMALL, seconds=0.5)) as opened:
        folder = Path(opened.start_recording("long"))
        for begin in range(0, 60, 10):
            send_updates(opened, *map(make_update, range(begin, begin + 10)))
            wait_until(partial(has_written, folder, begin + 5))
        opened.stop_recording()
    assert len(read_recording(folder)) == 60


def test_closing_the_service_ends_a_recording_in_order(tmp_path: Path) -> None:
    with running_recorder(tmp_path, SMALL) as opened:
        folder = Path(opened.start_recording("desk"))
        send_updates(opened, *map(make_update, range(4)))
    assert len(read_recording(folder)) == 4


def test_a_recording_without_a_frame_makes_no_folder(tmp_path: Path) -> None:
    with running_recorder(tmp_path, SMALL) as opened:
        folder = Path(opened.start_recording("nothing"))
        opened.stop_recording()
    assert not folder.exists()


def test_names_that_will_not_do_are_refused(tmp_path: Path) -> None:
    (tmp_path / "recordings" / "old").mkdir(parents=True)
    with running_recorder(tmp_path, SMALL) as opened:
        for name in ("", "../desk", "a/b", ".hidden", "a b", "x" * 65, "a\n"):
            assert command_error(partial(opened.start_recording, name)).startswith("bad-request")
        assert "there is a recording 'old' already" in command_error(
            lambda: opened.start_recording("old")
        )
        folder = opened.start_recording("new")
        assert folder in command_error(lambda: opened.start_recording("newer"))


def test_another_camera_ends_the_recording_and_the_reason_is_said(tmp_path: Path) -> None:
    other = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    with running_recorder(tmp_path, SMALL) as opened:
        folder = Path(opened.start_recording("desk"))
        send_updates(opened, make_update(0), make_update(1), make_update(2, camera=other))
        wait_until(lambda: opened.recording == "")
        assert "the camera changed during recording" in opened.warning
    assert len(read_recording(folder)) == 2


def test_a_process_that_dies_ends_the_recording_and_that_is_said(tmp_path: Path) -> None:
    with running_recorder(tmp_path, SMALL) as opened:
        folder = Path(opened.start_recording("desk"))
        send_updates(opened, *map(make_update, range(4)))
        wait_until((folder / "associations.txt").exists)
        (child,) = child_pids()
        os.kill(child, signal.SIGKILL)
        wait_until(lambda: opened.recording == "")
        assert opened.warning == f"recorder: its process ended and cut off {folder}"


class _Ring:
    """A ring in this process, and a recording of it."""

    def __init__(self, folder: Path) -> None:
        self.ends: list[RecordingResult] = []
        self.writer = RecordRingWriter("trial", 0.2, 1 << 22)
        self.reader = RecordRingReader(self.writer.memory)
        self.folder = folder

    def record(self, frames: int) -> RecordingResult:
        """What came of a recording that begins when all the frames have been put."""
        for seq in range(frames):
            write_frame(self.writer, make_update(seq), pack_depth)
        RecordingWriter(self.reader, 0, self.folder, self.ends.append).stop(frames)
        return self.ends[-1]


def test_frames_that_were_overwritten_before_they_could_be_written_are_counted(
    tmp_path: Path,
) -> None:
    end = _Ring(tmp_path / "slow").record(frames=40)
    assert end.error == ""
    assert 0 < end.frame_count < 40
    assert end.frame_count + end.missed_frames == 40
    assert len(read_recording(end.folder)) == end.frame_count


def test_a_disk_with_too_little_left_ends_it_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_module, "MIN_FREE_BYTES", 10**18)
    end = _Ring(tmp_path / "full").record(frames=2)
    assert end.frame_count == 0
    assert "are left on the disk; free some space" in end.error
    assert not end.folder.exists()
