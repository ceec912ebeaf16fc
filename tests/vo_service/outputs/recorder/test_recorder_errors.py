"""Errors of the flight recorder: its messages, and that the service continues."""

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
    SMALL,
    command_error,
    list_incidents,
    make_update,
    running_recorder,
    save_incident,
    send_updates,
    wait_for_incident,
)
from tests.waiting import wait_until
from vo_service import app
from vo_service.config import Config, OdometryConfig
from vo_service.config_tables import RecorderConfig
from vo_service.outputs.recorder.client import open_recorder
from vo_service.types.odometry_update import TrackingState
from vo_service.types.outputs import NullRecorder

pytestmark = pytest.mark.subprocess

LOST = TrackingState.LOST


def only_child() -> int:
    """Return the process id of the recorder's process."""
    (child,) = child_pids()
    return child


def test_a_killed_recorder_process_is_restarted_with_its_frames(
    tmp_path: Path,
) -> None:
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, *map(make_update, range(4)))
        first = only_child()
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: "started again" in recorder.warning)
        wait_until(lambda: recorder.is_ready and first not in child_pids())
        assert len(read_recording(save_incident(recorder, "command"))) == 4
        assert recorder.warning == ""


def test_an_unusable_folder_is_reported_and_the_service_continues(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    unusable = tmp_path / "elsewhere"
    unusable.symlink_to("x" * 300)  # fails for root too, and not with ENOENT
    with running_recorder(tmp_path, replace(SMALL, folder=unusable)) as recorder:
        wait_until(lambda: "elsewhere: cannot be used: File name too long" in recorder.warning)
        unusable.unlink()
        wait_until(lambda: recorder.warning == "")
    assert [record.levelname for record in caplog.records] == ["ERROR"]


def test_incidents_and_recordings_have_separate_faults(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        send_updates(recorder, make_update(0))
        resource.prlimit(only_child(), resource.RLIMIT_FSIZE, (1000, 1000))
        recorder.save("command")
        wait_until(lambda: "incidents: the disk is full" in recorder.warning)
        recorder.start_recording("desk")
        for seq in range(1, 10):  # a frame is written when its images are packed, so a little later
            send_updates(recorder, make_update(seq))
        wait_until(lambda: "desk" in recorder.warning)
        assert "incidents: the disk is full" in recorder.warning
        recorder.start_recording("table")
        assert "desk" not in recorder.warning
        assert "incidents: the disk is full" in recorder.warning
    assert list_incidents(tmp_path) == []


def test_impossible_requests_are_refused_with_the_reason(tmp_path: Path) -> None:
    with running_recorder(tmp_path) as recorder:
        assert command_error(lambda: recorder.save("x")) == "not-possible: no frame has arrived yet"
        assert command_error(recorder.stop_recording) == "not-possible: nothing is being recorded"
        send_updates(recorder, make_update(0))
        os.kill(only_child(), signal.SIGSTOP)
        recorder.save("command")
        assert "another incident is being written" in command_error(lambda: recorder.save("again"))
        os.kill(only_child(), signal.SIGCONT)
        wait_for_incident(tmp_path, "command")


def test_the_service_continues_without_memory_for_the_recorder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with limit_file_size(1000):
        recorder = open_recorder(SMALL, {})
    assert isinstance(recorder, NullRecorder)
    assert recorder.warning == "recorder: switched off: cannot allocate its memory: File too large"
    assert command_error(lambda: recorder.save("x")).startswith(
        "not-possible: recorder: switched off"
    )


@pytest.mark.parametrize(
    "config",
    [
        Config(recorder=RecorderConfig(enabled=False)),
        Config(odometry=OdometryConfig(profile="small")),
    ],
)
def test_a_disabled_recorder_refuses_with_the_reason(config: Config) -> None:
    recorder = app.open_recorder(config)
    assert recorder.warning == recorder.recording == ""
    assert "recorder.enabled" in command_error(lambda: recorder.start_recording("desk"))
