"""Run of a method on a recording, in this process."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numba
import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.recording.recording import Recording
from tests.conftest import FRAMES
from vo_service.tools.compare.batch import KernelsCompiled, RunRequest
from vo_service.tools.compare.recordings import FrameSelection
from vo_service.tools.compare.run_outcome import CompletedRun
from vo_service.tools.compare.runner import WARM_UP_FRAMES, run_method
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import StageTimer

BUSY_S = 0.02
KERNEL = "import numba\nnumba.njit('i8(i8)', cache=True)(lambda number: number)\n"


@dataclass
class RecordingFactory:
    """Factory that records the frames of each odometry that it made."""

    action: Callable[[], None] = lambda: None
    frames: list[list[int]] = field(default_factory=list)
    uses_truth = False

    @property
    def settings(self) -> Mapping[str, object]:
        return {}

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        on_progress("nothing")

    def make(self, stopwatch: StageTimer, recording: Recording) -> "RecordingMethod":
        self.frames.append([])
        return RecordingMethod(self.frames[-1], self.action)


@dataclass
class RecordingMethod:
    """Method that reports no motion and performs an action at each frame."""

    frames: list[int]
    action: Callable[[], None]

    def estimate(self, frame: RgbdFrame) -> Estimate:
        self.frames.append(frame.seq)
        self.action()
        return Estimate(True, "", np.eye(4), np.eye(4), np.zeros((6, 6)))


def run_all(folder: Path, factory: RecordingFactory, max_frames: int | None = None) -> CompletedRun:
    messages: list[object] = []
    run = run_method(
        RunRequest(folder, None, factory, FrameSelection(max_frames=max_frames)), messages.append
    )
    assert messages[:2] == ["nothing", "first frames"]
    assert isinstance(run, CompletedRun)
    return run


def test_a_method_warms_up_on_the_first_frames_and_is_made_again(recording: Path) -> None:
    factory = RecordingFactory()
    run = run_all(recording, factory)
    assert factory.frames == [list(range(WARM_UP_FRAMES)), list(range(FRAMES))]
    assert (len(run.frames), run.skipped) == (FRAMES, 0)


def test_a_broken_frame_at_the_start_is_skipped_and_logged_once(
    copy_recording: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    folder = copy_recording()
    second = sorted((folder / "depth").iterdir())[1]
    os.truncate(second, 500)
    factory = RecordingFactory()
    run = run_all(folder, factory)
    assert factory.frames == [[0, 2], [0, *range(2, FRAMES)]]
    assert (len(run.frames), run.skipped) == (FRAMES - 1, 1)
    assert caplog.text.count(f"frame 1 is skipped: {second}") == 1


@pytest.mark.slow
def test_after_compilation_no_frame_is_counted_unless_requested(recording: Path) -> None:
    factory = RecordingFactory(_compile_a_kernel)
    request = RunRequest(recording, None, factory)
    assert run_method(request, lambda message: None) == KernelsCompiled()
    assert factory.frames == [list(range(WARM_UP_FRAMES))]
    run = run_method(replace(request, stop_after_compiling=False), lambda message: None)
    assert isinstance(run, CompletedRun)
    assert len(run.frames) == FRAMES


@pytest.mark.subprocess
def test_compilation_in_another_process_does_not_count(recording: Path, tmp_path: Path) -> None:
    kernel = tmp_path / "kernel.py"
    kernel.write_text(KERNEL)

    @cache  # at the first frame only
    def compile_in_subprocess() -> None:
        subprocess.run([sys.executable, kernel], check=True)

    assert (
        len(run_all(recording, RecordingFactory(compile_in_subprocess), max_frames=1).frames) == 1
    )


def _compile_a_kernel() -> None:
    numba.njit("i8(i8)")(lambda number: number)


def _use_cpu_in_a_thread() -> None:
    def use_cpu() -> None:
        while time.thread_time() < BUSY_S:
            pass

    thread = threading.Thread(target=use_cpu)
    thread.start()
    thread.join()


def test_the_time_of_a_methods_own_threads_counts(recording: Path) -> None:
    run = run_all(recording, RecordingFactory(_use_cpu_in_a_thread), max_frames=2)
    assert run.frames["cpu_ms"].min() >= 1e3 * BUSY_S
