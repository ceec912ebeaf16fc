"""All runs, one after another, and what is kept from one time to the next."""

import io
import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from drivers.core.errors import InputError
from tests.conftest import FRAMES
from tests.vo_service.tools.benchmark.faulty_methods import FaultyMethodFactory
from vo_service.cli.loop_closure_observer import LoopClosureObserverFactory
from vo_service.config import OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.terminal import Terminal
from vo_service.tools.benchmark.batch import BatchPlan, BatchResult, run_batch
from vo_service.tools.benchmark.cache_key import make_cache_key
from vo_service.tools.benchmark.method_factory import ConfiguredMethodFactory, MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.recordings import open_recordings
from vo_service.tools.benchmark.run import RunState

CopyRecording = Callable[..., Path]
VERSIONS = {"numpy": "2"}
LIMIT_S = 100.0


class FakeBatchTerminal(io.StringIO):
    """A terminal that remembers."""

    def isatty(self) -> bool:
        return True


def compare(
    folder: Path,
    output: Path,
    recipes: Mapping[str, MethodFactory],
    stopped: bool = False,
    again: bool = False,
    listener: ObserverFactory = NULL_OBSERVER,
) -> tuple[list[BatchResult], str]:
    """All runs, and what was to be seen."""
    screen = FakeBatchTerminal()
    stop = threading.Event()
    if stopped:
        stop.set()
    plan = BatchPlan(open_recordings([folder], None), recipes, output, LIMIT_S, again, listener)
    return list(run_batch(plan, Terminal(screen), stop)), screen.getvalue()


def states(entries: list[BatchResult]) -> list[RunState]:
    return [entry.outcome.state for entry in entries]


@pytest.mark.subprocess
@pytest.mark.usefixtures("forked_runs")
def test_a_failure_does_not_keep_the_others_from_running_and_is_tried_again(
    recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    entries, _ = compare(
        recording, tmp_path, {"bad": FaultyMethodFactory("segfault"), "good": FaultyMethodFactory()}
    )
    assert states(entries) == [RunState.CRASHED, RunState.DONE]
    assert "corner, bad (run 1 of 2): crashed (signal 11" in caplog.text
    kept, _ = compare(recording, tmp_path, {"bad": FaultyMethodFactory("segfault")}, stopped=True)
    assert states(kept) == [RunState.CRASHED]  # known from before, and not run
    entries, seen = compare(
        recording, tmp_path, {"bad": FaultyMethodFactory("segfault"), "good": FaultyMethodFactory()}
    )
    assert states(entries) == [RunState.CRASHED, RunState.DONE]
    assert "bad (run 1 of 2): starting" in seen
    assert "good (run 2 of 2): kept from before" in seen


@pytest.mark.subprocess
@pytest.mark.usefixtures("forked_runs")
def test_what_is_kept_is_made_anew_when_asked_for_or_when_the_settings_change(
    recording: Path, tmp_path: Path
) -> None:
    first, _ = compare(recording, tmp_path, {"trial": FaultyMethodFactory()})
    kept, seen = compare(recording, tmp_path, {"trial": FaultyMethodFactory()})
    assert "kept from before" in seen
    assert kept[0].outcome.run.wall_s == first[0].outcome.run.wall_s
    _, seen = compare(recording, tmp_path, {"trial": FaultyMethodFactory()}, again=True)
    assert "starting" in seen
    changed, seen = compare(recording, tmp_path, {"trial": FaultyMethodFactory("lose it")})
    assert "starting" in seen
    assert changed[0].outcome.run.failed == 9


def test_after_a_stop_nothing_is_begun(recording: Path, tmp_path: Path) -> None:
    recipes = {"one": FaultyMethodFactory(), "two": FaultyMethodFactory()}
    entries, seen = compare(recording, tmp_path, recipes, stopped=True)
    assert states(entries) == [RunState.NOT_RUN, RunState.NOT_RUN]
    assert "starting" not in seen
    assert list(tmp_path.iterdir()) == []


def key(
    folder: Path,
    recipe: MethodFactory,
    versions: Mapping[str, str] = VERSIONS,
    listener: ObserverFactory = NULL_OBSERVER,
) -> str:
    return make_cache_key(open_recordings([folder], None)[0], recipe, versions, listener)


def test_the_key_changes_with_whatever_changes_the_result(copy_recording: CopyRecording) -> None:
    folder, recipe = copy_recording(), ConfiguredMethodFactory(OdometryConfig())
    keys = [key(folder, recipe)]
    keys.append(key(folder, ConfiguredMethodFactory(OdometryConfig(feature_count=500))))
    keys.append(key(folder, recipe, {"numpy": "3"}))
    os.utime(folder / "depth" / "0.200000.png", (1, 1))
    keys.append(key(folder, recipe))
    camera = folder / "camera.toml"
    camera.write_text(camera.read_text().replace("fx = ", "fx = 1"))
    keys.append(key(folder, recipe))
    assert len(set(keys)) == 5
    assert key(folder, recipe) == keys[-1]


def test_runs_with_loops_are_told_apart_from_those_without(recording: Path) -> None:
    listeners = (
        NULL_OBSERVER,
        LoopClosureObserverFactory(MapConfig()),
        LoopClosureObserverFactory(MapConfig(keyframe_database_mb=20)),
    )
    keys = [key(recording, FaultyMethodFactory(), listener=listener) for listener in listeners]
    assert len(set(keys)) == 3
    assert (
        key(
            recording,
            FaultyMethodFactory(),
            listener=LoopClosureObserverFactory(MapConfig(enabled=False)),
        )
        == keys[1]
    )


@pytest.mark.subprocess
@pytest.mark.usefixtures("forked_runs")
def test_a_run_with_loops_is_kept_with_them(recording: Path, tmp_path: Path) -> None:
    loops = LoopClosureObserverFactory(MapConfig())
    first, _ = compare(recording, tmp_path, {"trial": FaultyMethodFactory()}, listener=loops)
    kept, seen = compare(recording, tmp_path, {"trial": FaultyMethodFactory()}, listener=loops)
    assert "kept from before" in seen
    with_loops, before = kept[0].outcome.run.loop_closure, first[0].outcome.run.loop_closure
    assert with_loops is not None
    assert before is not None
    assert (with_loops.map_keyframes, with_loops.loop_closures, with_loops.cpu_ms_per_frame) == (
        1,
        0,
        before.cpu_ms_per_frame,
    )
    assert len(with_loops.trajectory) == FRAMES
    without, seen = compare(recording, tmp_path, {"trial": FaultyMethodFactory()})
    assert "starting" in seen
    assert without[0].outcome.run.loop_closure is None
    assert [entry.has_loop_closure for entry in (*kept, *without)] == [True, False]


def test_the_truth_is_in_the_key_only_where_it_is_used(copy_recording: CopyRecording) -> None:
    folder = copy_recording()
    blind, cheat = FaultyMethodFactory(), FaultyMethodFactory(uses_truth=True)
    before = key(folder, blind), key(folder, cheat)
    truth = folder / "groundtruth.txt"
    truth.write_text("\n".join(truth.read_text().splitlines()[:-1]) + "\n")
    assert key(folder, blind) == before[0]
    assert key(folder, cheat) != before[1]


def test_two_folders_of_one_name_are_refused(copy_recording: CopyRecording, tmp_path: Path) -> None:
    folders = [copy_recording(name="a/desk"), copy_recording(name="b/desk")]
    with pytest.raises(InputError, match=r"a/desk and .*b/desk: results are kept by the folder's"):
        open_recordings(folders, None)
