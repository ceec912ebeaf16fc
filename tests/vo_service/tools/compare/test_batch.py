"""Batches of runs and their cache."""

import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.vo_service.captured_terminal import CapturedTerminal
from tests.vo_service.tools.compare.faulty_methods import FaultyMethodFactory
from vo_service.config import OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.terminal import Terminal
from vo_service.tools.compare.batch import BatchPlan, run_batch
from vo_service.tools.compare.methods import ConfiguredMethodFactory, MethodFactory
from vo_service.tools.compare.observers import (
    NULL_OBSERVER,
    LoopClosureObserverFactory,
    ObserverFactory,
)
from vo_service.tools.compare.recordings import open_recordings
from vo_service.tools.compare.run_cache import make_cache_key
from vo_service.tools.compare.run_outcome import RunOutcome, RunState

CopyRecording = Callable[..., Path]
VERSIONS = {"numpy": "2"}
LIMIT_S = 100.0


def run_all(
    folder: Path,
    output: Path,
    factories: Mapping[str, MethodFactory],
    stopped: bool = False,
    force: bool = False,
) -> tuple[list[RunOutcome], str]:
    """Run a batch and return the outcomes and the terminal's output."""
    screen = CapturedTerminal()
    stop = threading.Event()
    if stopped:
        stop.set()
    plan = BatchPlan(open_recordings([folder], None), factories, output, LIMIT_S, force)
    ((_, outcomes),) = run_batch(plan, Terminal(screen), stop)
    return list(outcomes.values()), screen.getvalue()


def run_states(outcomes: list[RunOutcome]) -> list[RunState]:
    return [outcome.state for outcome in outcomes]


@pytest.mark.subprocess
@pytest.mark.usefixtures("forked_runs")
def test_the_runs_of_a_recording_are_ready_before_the_next_one_begins(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    recordings = open_recordings([copy_recording(name=name) for name in ("first", "next")], None)
    plan = BatchPlan(recordings, {"good": FaultyMethodFactory()}, tmp_path / "runs", LIMIT_S)
    runs = run_batch(plan, Terminal(CapturedTerminal()), threading.Event())
    assert next(runs)[0] is recordings[0]
    assert [folder.name for folder in (tmp_path / "runs").iterdir()] == ["first"]


@pytest.mark.subprocess
@pytest.mark.usefixtures("forked_runs")
def test_after_a_failure_the_others_run_and_it_is_run_again(
    recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    results, _ = run_all(
        recording, tmp_path, {"bad": FaultyMethodFactory("segfault"), "good": FaultyMethodFactory()}
    )
    assert run_states(results) == [RunState.CRASHED, RunState.DONE]
    assert "corner, bad (run 1 of 2): crashed (signal 11" in caplog.text
    cached, _ = run_all(recording, tmp_path, {"bad": FaultyMethodFactory("segfault")}, stopped=True)
    assert run_states(cached) == [RunState.CRASHED]  # from the cache, not run
    results, output_text = run_all(
        recording, tmp_path, {"bad": FaultyMethodFactory("segfault"), "good": FaultyMethodFactory()}
    )
    assert run_states(results) == [RunState.CRASHED, RunState.DONE]
    assert "bad (run 1 of 2): starting" in output_text
    assert "good (run 2 of 2): cached" in output_text


@pytest.mark.subprocess
@pytest.mark.usefixtures("forked_runs")
def test_a_cached_run_is_run_again_by_force_or_with_other_settings(
    recording: Path, tmp_path: Path
) -> None:
    first, _ = run_all(recording, tmp_path, {"trial": FaultyMethodFactory()})
    cached, output_text = run_all(recording, tmp_path, {"trial": FaultyMethodFactory()})
    assert "cached" in output_text
    assert cached[0].run.wall_s == first[0].run.wall_s
    _, output_text = run_all(recording, tmp_path, {"trial": FaultyMethodFactory()}, force=True)
    assert "starting" in output_text
    changed, output_text = run_all(recording, tmp_path, {"trial": FaultyMethodFactory("lose it")})
    assert "starting" in output_text
    assert changed[0].run.failed == 9


def test_after_a_stop_no_run_is_started(recording: Path, tmp_path: Path) -> None:
    factories = {"one": FaultyMethodFactory(), "two": FaultyMethodFactory()}
    results, output_text = run_all(recording, tmp_path, factories, stopped=True)
    assert run_states(results) == [RunState.NOT_RUN, RunState.NOT_RUN]
    assert "starting" not in output_text
    assert list(tmp_path.iterdir()) == []


def key(
    folder: Path,
    factory: MethodFactory,
    versions: Mapping[str, str] = VERSIONS,
    observer: ObserverFactory = NULL_OBSERVER,
) -> str:
    return make_cache_key(open_recordings([folder], None)[0], factory, versions, observer)


def test_the_key_changes_with_everything_that_changes_the_result(
    copy_recording: CopyRecording,
) -> None:
    folder, factory = copy_recording(), ConfiguredMethodFactory(OdometryConfig())
    keys = [key(folder, factory)]
    keys.append(key(folder, ConfiguredMethodFactory(OdometryConfig(feature_count=500))))
    keys.append(key(folder, factory, {"numpy": "3"}))
    os.utime(folder / "depth" / "0.200000.png", (1, 1))
    keys.append(key(folder, factory))
    camera = folder / "camera.toml"
    camera.write_text(camera.read_text().replace("fx = 2", "fx = 3"))
    keys.append(key(folder, factory))
    assert len(set(keys)) == 5
    assert key(folder, factory) == keys[-1]


def test_runs_with_and_without_loop_closure_have_different_keys(recording: Path) -> None:
    def key_with(observer: ObserverFactory) -> str:
        return key(recording, FaultyMethodFactory(), observer=observer)

    configs = (MapConfig(), MapConfig(keyframe_database_mb=20), MapConfig(enabled=False))
    default, smaller, disabled = (key_with(LoopClosureObserverFactory(c)) for c in configs)
    assert len({key_with(NULL_OBSERVER), default, smaller}) == 3
    assert disabled == default


def test_the_truth_is_in_the_key_only_if_it_is_used(copy_recording: CopyRecording) -> None:
    folder = copy_recording()
    without_truth, with_truth = FaultyMethodFactory(), FaultyMethodFactory(uses_truth=True)
    keys = key(folder, without_truth), key(folder, with_truth)
    truth = folder / "groundtruth.txt"
    truth.write_text("\n".join(truth.read_text().splitlines()[:-1]) + "\n")
    assert key(folder, without_truth) == keys[0]
    assert key(folder, with_truth) != keys[1]
