"""A run in a process of its own: whatever a method does, the others go on."""

import logging
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.core.trajectory import read_trajectory
from tests.conftest import FRAMES
from tests.resource_leaks import resources_in_use
from tests.vo_service.tools.benchmark.faulty_methods import FaultyMethodFactory
from tests.waiting import DEFAULT_TIMEOUT_S
from vo_service.tools.benchmark.messages import RunPreparing, RunProgress, RunRequest
from vo_service.tools.benchmark.run import RunOutcome, RunState
from vo_service.tools.benchmark.subprocess_run import run_in_subprocess
from vo_service.tools.benchmark.worker_main import pin_to_one_cpu

pytestmark = pytest.mark.subprocess


def ran(folder: Path, act: str, limit_s: float = DEFAULT_TIMEOUT_S) -> RunOutcome:
    """The outcome of a trial; nothing may be left of its process."""
    before = resources_in_use()
    job = RunRequest(folder, None, FaultyMethodFactory(act), logging.WARNING)
    outcome = run_in_subprocess(job, limit_s, lambda word: None, threading.Event())
    assert resources_in_use() <= before
    return outcome


def test_a_run_to_the_end_has_every_frame_with_its_times(recording: Path) -> None:
    words: list[RunPreparing | RunProgress] = []
    job = RunRequest(recording, None, FaultyMethodFactory(), logging.WARNING)
    outcome = run_in_subprocess(job, DEFAULT_TIMEOUT_S, words.append, threading.Event())
    frames = outcome.run.frames
    assert (outcome.state, outcome.error, len(frames)) == (RunState.DONE, "", FRAMES)
    truth = read_trajectory(recording / "groundtruth.txt")
    np.testing.assert_allclose(frames.stamps_s, truth.stamps_s, atol=1e-6)
    np.testing.assert_array_equal(frames.inliers, 50)
    assert np.all(frames.wall_ms > 0)
    assert np.all(frames.cpu_ms >= 0)
    assert list(outcome.run.stage_ms) == ["standing"]
    assert outcome.run.memory_mb > 10
    assert words[0] == RunPreparing("nothing")
    assert RunProgress(1, FRAMES) in words


@pytest.mark.parametrize(
    ("act", "state", "trouble"),
    [
        ("raise", RunState.ERROR, "ZeroDivisionError: integer division or modulo by zero (faulty_"),
        ("refuse", RunState.FAILED, "out of luck; try again"),
        ("segfault", RunState.CRASHED, "crashed (signal 11, Segmentation fault)"),
        ("exit", RunState.CRASHED, "ended (exit code 1); last line: enough"),
    ],
)
def test_what_goes_wrong_is_told_in_one_line(
    recording: Path, act: str, state: RunState, trouble: str
) -> None:
    outcome = ran(recording, act)
    assert (outcome.state, len(outcome.run.frames)) == (state, 0)
    assert outcome.error.startswith(trouble)
    assert "\n" not in outcome.error
    assert ("_divide" in outcome.details) == (act == "raise")


def test_kernels_are_compiled_in_a_process_of_their_own(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    words: list[RunPreparing | RunProgress] = []
    job = RunRequest(recording, None, FaultyMethodFactory("compile"), logging.WARNING)
    outcome = run_in_subprocess(job, DEFAULT_TIMEOUT_S, words.append, threading.Event())
    assert (outcome.state, len(outcome.run.frames)) == (RunState.DONE, FRAMES)
    assert words.count(RunPreparing("nothing")) == 2


def test_a_run_stays_on_one_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen: list[set[int]] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 5, 7})
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, processors: chosen.append(processors))
    pin_to_one_cpu()
    assert len(chosen) == len(chosen[0]) == 1
    assert chosen[0] <= {2, 5, 7}


def test_a_run_that_takes_too_long_is_ended(recording: Path) -> None:
    outcome = ran(recording, "hang", limit_s=1.0)
    assert (outcome.state, outcome.error) == (
        RunState.TIMED_OUT,
        "took longer than 1 s (--time-limit)",
    )


def test_a_stop_ends_the_run_at_once(recording: Path) -> None:
    stop = threading.Event()
    job = RunRequest(recording, None, FaultyMethodFactory("hang"), logging.WARNING)
    outcome = run_in_subprocess(job, DEFAULT_TIMEOUT_S, lambda word: stop.set(), stop)
    assert (outcome.state, outcome.error) == (RunState.NOT_RUN, "stopped before its end")


def test_a_frame_that_cannot_be_read_is_in_our_log(
    copy_recording: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    folder = copy_recording()
    broken = folder / "rgb" / "0.200000.png"
    os.truncate(broken, 500)
    outcome = ran(folder, "go on")
    assert (len(outcome.run.frames), outcome.run.skipped) == (FRAMES - 1, 1)
    assert f"frame 6 is skipped: {broken}" in caplog.text
