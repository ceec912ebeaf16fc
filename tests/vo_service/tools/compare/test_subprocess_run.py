"""Run in a subprocess, which may crash or hang without harm to other runs."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import read_trajectory
from tests.conftest import FRAMES
from tests.resource_leaks import resources_in_use
from tests.vo_service.tools.compare.faulty_methods import FaultyMethodFactory
from tests.waiting import DEFAULT_TIMEOUT_S
from vo_service.tools.compare.batch import RunProgress, RunRequest, run_in_subprocess
from vo_service.tools.compare.run_outcome import RunOutcome, RunState
from vo_service.tools.compare.worker_main import pin_to_one_cpu

pytestmark = pytest.mark.subprocess


def run_faulty_method(
    folder: Path, action: str, time_limit_s: float = DEFAULT_TIMEOUT_S
) -> RunOutcome:
    """Run a faulty method and check that its process leaves no resources."""
    before = resources_in_use()
    request = RunRequest(folder, None, FaultyMethodFactory(action))
    outcome = run_in_subprocess(request, time_limit_s, lambda message: None, threading.Event())
    assert resources_in_use() <= before
    return outcome


def test_a_complete_run_has_every_frame_with_its_times(recording: Path) -> None:
    messages: list[str | RunProgress] = []
    request = RunRequest(recording, None, FaultyMethodFactory())
    outcome = run_in_subprocess(request, DEFAULT_TIMEOUT_S, messages.append, threading.Event())
    frames = outcome.run.frames
    assert (outcome.state, outcome.error, len(frames)) == (RunState.DONE, "", FRAMES)
    truth = read_trajectory(recording / "groundtruth.txt")
    np.testing.assert_allclose(frames["stamp_s"], truth.stamps_s, atol=1e-6)
    np.testing.assert_array_equal(frames["inliers"], 50)
    assert np.all(frames["wall_ms"] > 0)
    assert np.all(frames["cpu_ms"] >= 0)
    assert list(outcome.run.stage_ms) == ["static"]
    assert outcome.run.memory_mb > 10
    assert messages[0] == "nothing"
    assert RunProgress(1, FRAMES) in messages


@pytest.mark.usefixtures("forked_runs")
@pytest.mark.parametrize(
    ("action", "state", "error"),
    [
        ("raise", RunState.ERROR, "ZeroDivisionError: integer division or modulo by zero (faulty_"),
        ("refuse", RunState.FAILED, "out of luck; try again"),
        ("segfault", RunState.CRASHED, "crashed (signal 11, Segmentation fault)"),
        ("exit", RunState.CRASHED, "ended (exit code 1); last line: enough"),
    ],
)
def test_errors_are_reported_in_one_line(
    recording: Path, action: str, state: RunState, error: str
) -> None:
    outcome = run_faulty_method(recording, action)
    assert (outcome.state, len(outcome.run.frames)) == (state, 0)
    assert outcome.error.startswith(error)
    assert "\n" not in outcome.error
    assert ("_divide" in outcome.details) == (action == "raise")


def test_kernels_are_compiled_in_a_separate_process(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    messages: list[str | RunProgress] = []
    request = RunRequest(recording, None, FaultyMethodFactory("compile"))
    outcome = run_in_subprocess(request, DEFAULT_TIMEOUT_S, messages.append, threading.Event())
    assert (outcome.state, len(outcome.run.frames)) == (RunState.DONE, FRAMES)
    assert messages.count("nothing") == 2


def test_a_run_stays_on_one_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    affinities: list[set[int]] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 5, 7})
    monkeypatch.setattr(
        os, "sched_setaffinity", lambda _, processors: affinities.append(processors)
    )
    pin_to_one_cpu()
    assert len(affinities) == len(affinities[0]) == 1
    assert affinities[0] <= {2, 5, 7}


@pytest.mark.usefixtures("forked_runs")
def test_a_run_that_takes_too_long_is_killed(recording: Path) -> None:
    outcome = run_faulty_method(recording, "hang", time_limit_s=1.0)
    assert (outcome.state, outcome.error) == (
        RunState.TIMED_OUT,
        "took longer than 1 s (--time-limit)",
    )
