"""When the flight recorder cannot do as it is told: what it says, and that the service goes on."""

import os
import resource
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from tests.drivers.tum.read_recording import read_recording
from tests.full_disk import limit_file_size
from tests.resource_leaks import child_pids
from tests.vo_service.outputs.recorder.recorder_inputs import (
    command_error,
    list_incidents,
    make_update,
    running_recorder,
    send_updates,
    wait_for_incident,
)
from tests.waiting import wait_until
from vo_service.config_tables import RecorderConfig
from vo_service.outputs.recorder.factory import open_recorder
from vo_service.types import NullRecorder, TrackingState

pytestmark = pytest.mark.subprocess

SMALL = RecorderConfig(max_mb=20)
LOST = TrackingState.LOST


def only_child() -> int:
    """Process number of the recorder's process."""
    (child,) = child_pids()
    return child


def test_its_process_that_is_killed_comes_back_and_the_frames_are_still_there(
    tmp_path: Path,
) -> None:
    with running_recorder(tmp_path, SMALL) as recording:
        send_updates(recording, *map(make_update, range(4)))
        first = only_child()
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: "started again" in recording.warning)
        wait_until(lambda: recording.is_ready and first not in child_pids())
        recording.save("command")
        assert len(read_recording(wait_for_incident(tmp_path, "command"))) == 4
        assert recording.warning == ""


def test_a_full_disk_is_said_and_leaves_nothing_half_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running_recorder(tmp_path, SMALL) as recording:
        send_updates(recording, *map(make_update, range(4)))
        # Its files cannot grow beyond this: a full disk on request.
        resource.prlimit(only_child(), resource.RLIMIT_FSIZE, (1000, 1000))
        for _ in range(2):
            recording.save("command")
            wait_until(lambda: not recording.is_saving)
            assert "incidents: the disk is full" in recording.warning
        send_updates(recording, make_update(4))
    assert list_incidents(tmp_path) == []
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_a_folder_that_cannot_be_used_is_told_and_no_reason_to_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    closed = tmp_path / "elsewhere"
    closed.symlink_to("x" * 300)  # refused to root too, and not as one that is not there
    with running_recorder(tmp_path, replace(SMALL, folder=closed)) as recording:
        wait_until(lambda: "elsewhere: cannot be used: File name too long" in recording.warning)
        closed.unlink()
        wait_until(lambda: recording.warning == "")
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_incidents_and_recordings_have_each_their_own_trouble(tmp_path: Path) -> None:
    with running_recorder(tmp_path, SMALL) as recording:
        send_updates(recording, make_update(0))
        resource.prlimit(only_child(), resource.RLIMIT_FSIZE, (1000, 1000))
        recording.save("command")
        wait_until(lambda: "incidents: the disk is full" in recording.warning)
        recording.start_recording("desk")
        for seq in range(1, 10):  # a frame is written when its images are packed, so a little later
            send_updates(recording, make_update(seq))
        wait_until(lambda: "desk" in recording.warning)
        assert "incidents: the disk is full" in recording.warning
        recording.start_recording("table")
        assert "desk" not in recording.warning
        assert "incidents: the disk is full" in recording.warning


def test_what_cannot_be_done_is_refused_with_the_reason(tmp_path: Path) -> None:
    with running_recorder(tmp_path, SMALL) as recording:
        assert command_error(lambda: recording.save("x")) == "not-possible: no frame has come yet"
        assert command_error(recording.stop_recording) == "not-possible: nothing is being recorded"
        send_updates(recording, make_update(0))
        os.kill(only_child(), signal.SIGSTOP)
        recording.save("command")
        assert "is being written already" in command_error(lambda: recording.save("again"))
        os.kill(only_child(), signal.SIGCONT)
        wait_for_incident(tmp_path, "command")


def test_the_service_goes_on_without_a_recorder_that_has_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with limit_file_size(1000):
        opened = open_recorder(SMALL, {})
    assert isinstance(opened, NullRecorder)
    assert opened.warning == "recorder: switched off: its memory cannot be had: File too large"
    assert command_error(lambda: opened.save("x")).startswith(
        "not-possible: recorder: switched off"
    )


def test_a_recorder_that_is_switched_off_says_so_to_whoever_asks() -> None:
    opened = open_recorder(RecorderConfig(enabled=False), {})
    assert opened.warning == opened.recording == ""
    assert "recorder.enabled" in command_error(lambda: opened.start_recording("desk"))
