"""A method over a recording, within this process."""

import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numba
import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.trajectory import Trajectory
from tests.conftest import FRAMES
from vo_service.odometry.profiling import StageTimer
from vo_service.tools.benchmark.frame_selection import FrameSelection
from vo_service.tools.benchmark.messages import RunPreparing, RunRequest
from vo_service.tools.benchmark.run import CompletedRun
from vo_service.tools.benchmark.runner import WARM_UP_FRAMES, KernelsCompiledFirst, run_method
from vo_service.types import Estimate

BURNT_S = 0.02
KERNEL = "import numba\nnumba.njit('i8(i8)', cache=True)(lambda number: number)\n"


@dataclass
class Watched:
    """A recipe that remembers which frames each odometry that it made has seen."""

    act: Callable[[], None] = lambda: None
    seen: list[list[int]] = field(default_factory=list)
    uses_truth = False

    @property
    def settings(self) -> Mapping[str, object]:
        return {}

    def prepare(self, tell: Callable[[str], None]) -> None:
        tell("nothing")

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> "Watching":
        self.seen.append([])
        return Watching(self.seen[-1], self.act)


@dataclass
class Watching:
    """Stands still."""

    seen: list[int]
    act: Callable[[], None]

    def estimate(self, frame: RgbdFrame) -> Estimate:
        self.seen.append(frame.seq)
        self.act()
        return Estimate(True, "", np.eye(4), np.eye(4), np.zeros((6, 6)))


def followed(folder: Path, recipe: Watched, first: int | None = None) -> CompletedRun:
    words: list[object] = []
    run = run_method(
        RunRequest(folder, None, recipe, logging.WARNING, FrameSelection(max_frames=first)),
        words.append,
    )
    assert words[:2] == [RunPreparing("nothing"), RunPreparing("first frames")]
    return run


def test_a_method_warms_up_on_the_first_frames_and_is_then_made_anew(recording: Path) -> None:
    recipe = Watched()
    run = followed(recording, recipe)
    assert recipe.seen == [list(range(WARM_UP_FRAMES)), list(range(FRAMES))]
    assert (len(run.frames), run.skipped) == (FRAMES, 0)


def test_a_broken_frame_at_the_start_is_skipped_once(copy_recording: Callable[..., Path]) -> None:
    folder = copy_recording()
    second = sorted((folder / "depth").iterdir())[1]
    os.truncate(second, 500)
    recipe = Watched()
    run = followed(folder, recipe)
    assert recipe.seen == [[0, 2], [0, *range(2, FRAMES)]]
    assert (len(run.frames), run.skipped) == (FRAMES - 1, 1)


@pytest.mark.slow
def test_where_kernels_had_to_be_compiled_no_frame_is_counted_unless_it_has_to(
    recording: Path,
) -> None:
    recipe = Watched(_compile_a_kernel)
    with pytest.raises(KernelsCompiledFirst):
        followed(recording, recipe)
    assert recipe.seen == [list(range(WARM_UP_FRAMES))]
    job = RunRequest(recording, None, recipe, logging.WARNING, stop_after_compiling=False)
    assert len(run_method(job, lambda word: None).frames) == FRAMES


@pytest.mark.subprocess
def test_what_another_process_compiles_meanwhile_does_not_count(
    recording: Path, tmp_path: Path
) -> None:
    kernel = tmp_path / "kernel.py"
    kernel.write_text(KERNEL)

    def compile_elsewhere() -> None:
        subprocess.run([sys.executable, kernel], check=True)

    assert len(followed(recording, Watched(compile_elsewhere), first=1).frames) == 1


def _compile_a_kernel() -> None:
    numba.njit("i8(i8)")(lambda number: number)


def _burn_in_a_thread() -> None:
    def burn() -> None:
        while time.thread_time() < BURNT_S:
            pass

    thread = threading.Thread(target=burn)
    thread.start()
    thread.join()


def test_the_time_of_a_methods_own_threads_counts(recording: Path) -> None:
    run = followed(recording, Watched(_burn_in_a_thread), first=2)
    assert run.frames.cpu_ms.min() >= 1e3 * BURNT_S
