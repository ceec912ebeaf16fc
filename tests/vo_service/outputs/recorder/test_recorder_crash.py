"""The last frames after a crash or a kill of the service."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.drivers.tum.read_recording import read_recording
from tests.forked_process import ForkedProcess, program_of
from tests.resource_leaks import child_pids_of, is_alive
from tests.vo_service.outputs.recorder.crashing_service import FRAMES
from tests.vo_service.outputs.recorder.recorder_inputs import list_incidents, wait_for_incident
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

COMMAND = [sys.executable, "-c", program_of("tests.vo_service.outputs.recorder.crashing_service")]


class CrashingService:
    """The running service and its recorder's process."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self.process = process
        (self.recorder,) = child_pids_of(process.pid)

    def go(self) -> None:
        """Let the service end as requested."""
        assert self.process.stdin is not None
        self.process.stdin.write(b"\n")
        self.process.stdin.flush()
        self.process.wait(100)


@contextmanager
def service(state: Path, death: str) -> Iterator[CrashingService]:
    """Run a service that records frames; no process is left at the end."""
    with (state / "log").open("wb") as log:
        process = ForkedProcess(
            [*COMMAND, str(state), death],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
        )  # fmt: skip
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        crashing = CrashingService(process)
        try:
            yield crashing
            wait_until(lambda: not is_alive(crashing.recorder), "the recorder's end")
        finally:
            process.kill()


def test_the_last_frames_of_a_crashed_service_are_written(tmp_path: Path) -> None:
    with service(tmp_path, "segfault") as crashing:
        crashing.go()
        folder = wait_for_incident(tmp_path, "crash")
    assert crashing.process.returncode == -signal.SIGSEGV
    assert len(read_recording(folder)) == FRAMES
    assert '"frames": 10' in (folder / "status.jsonl").read_text()
    assert f"its last {FRAMES} frames are in {folder}" in (tmp_path / "log").read_text()


def test_frames_are_written_after_a_kill_despite_sigterm_to_all_processes(
    tmp_path: Path,
) -> None:
    with service(tmp_path, "killed") as crashing:
        crashing.process.kill()
        for number in (signal.SIGTERM, signal.SIGABRT, signal.SIGINT, signal.SIGHUP):
            os.kill(crashing.recorder, number)
        assert len(read_recording(wait_for_incident(tmp_path, "crash"))) == FRAMES


def test_a_crash_completes_the_current_recording(tmp_path: Path) -> None:
    with service(tmp_path, "exit") as crashing:
        crashing.go()
        assert len(read_recording(wait_for_incident(tmp_path, "crash"))) == FRAMES
    assert len(read_recording(tmp_path / "recordings" / "desk")) == FRAMES


def test_a_kill_of_all_processes_writes_and_leaves_nothing(tmp_path: Path) -> None:
    with service(tmp_path, "killed") as crashing:
        os.kill(crashing.recorder, signal.SIGKILL)
        crashing.process.kill()
    assert list_incidents(tmp_path) == []
