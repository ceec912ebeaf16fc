"""A cached run is loaded unchanged or not at all."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.core import UserFacingError
from drivers.core.geometry import Trajectory
from tests.full_disk import limit_file_size
from tests.vo_service.tools.compare.sample_runs import (
    CRASH,
    FRAMES,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    poses_along_x,
)
from vo_service.tools.compare.run_cache import (
    DETAILS_FILE,
    FRAMES_FILE,
    OPTIMIZED_TRAJECTORY_FILE,
    RESULT_FILE,
    TRAJECTORY_FILE,
    RunCache,
)
from vo_service.tools.compare.run_outcome import RunOutcome, RunState

KEY = "abc"
WALK = make_recording("walk")


@pytest.fixture
def cache(tmp_path: Path) -> RunCache:
    """Cache with a run that lost frames 5 to 9."""
    cache = RunCache(tmp_path / "walk" / "surf")
    cache.save(KEY, make_outcome(WALK, lost=range(5, 10), epoch_from=30), {"method": "surf"})
    return cache


def test_a_run_is_loaded_unchanged(cache: RunCache) -> None:
    loaded, expected = cache.load(KEY), make_outcome(WALK, lost=range(5, 10), epoch_from=30)
    assert loaded is not None
    assert loaded.state is RunState.DONE
    np.testing.assert_array_equal(loaded.run.frames, expected.run.frames)
    np.testing.assert_allclose(
        loaded.run.trajectory.T_world_camera, expected.run.trajectory.T_world_camera, atol=1e-6
    )
    assert (loaded.run.stage_ms, loaded.run.memory_mb) == ({"surf": 5.0}, 100.0)


@pytest.fixture
def loop_closure_cache(tmp_path: Path) -> RunCache:
    """Cache with a run that has an optimized trajectory."""
    cache = RunCache(tmp_path / "walk" / "surf")
    cache.save(KEY, make_outcome(WALK, step_m=0.02, loop_closure=make_loop_closure_run(WALK)), {})
    return cache


def test_the_result_of_loop_closure_is_loaded(loop_closure_cache: RunCache) -> None:
    loaded = loop_closure_cache.load(KEY)
    assert loaded is not None
    found = loaded.run.loop_closure
    assert found is not None
    assert (found.map_keyframes, found.loop_closures, found.cpu_ms_per_frame) == (3, 2, 1.5)
    T_world_camera = found.trajectory.T_world_camera
    np.testing.assert_allclose(T_world_camera, poses_along_x(FRAMES), atol=1e-6)


def test_a_run_with_a_cut_or_missing_optimized_trajectory_is_not_loaded(
    loop_closure_cache: RunCache,
) -> None:
    file = loop_closure_cache.path / OPTIMIZED_TRAJECTORY_FILE
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-1]))
    assert loop_closure_cache.load(KEY) is None
    file.unlink()
    assert loop_closure_cache.load(KEY) is None


def test_a_run_without_loop_closure_removes_an_earlier_one(loop_closure_cache: RunCache) -> None:
    loop_closure_cache.save(KEY, make_outcome(WALK), {})
    loaded = loop_closure_cache.load(KEY)
    assert loaded is not None
    assert loaded.run.loop_closure is None
    assert not (loop_closure_cache.path / OPTIMIZED_TRAJECTORY_FILE).exists()


def test_result_json_has_the_metrics_that_need_no_truth(cache: RunCache) -> None:
    result = json.loads((cache.path / RESULT_FILE).read_text())
    metrics = {name: result[name] for name in ("frames", "failed", "new_epochs", "cpu_s", "method")}
    assert metrics == {"frames": 40, "failed": 5, "new_epochs": 1, "cpu_s": 0.32, "method": "surf"}
    assert len((cache.path / TRAJECTORY_FILE).read_text().splitlines()) == FRAMES - 5
    assert len((cache.path / FRAMES_FILE).read_text().splitlines()) == FRAMES + 1


def test_a_run_with_another_key_is_not_loaded(cache: RunCache) -> None:
    assert cache.load("another") is None
    assert RunCache(cache.path.parent / "icp").load(KEY) is None


@pytest.mark.parametrize("name", [RESULT_FILE, TRAJECTORY_FILE, FRAMES_FILE])
@pytest.mark.parametrize("damage", ["gone", "cut", "nonsense"])
def test_a_damaged_run_is_not_loaded(cache: RunCache, name: str, damage: str) -> None:
    file = cache.path / name
    data = file.read_bytes()
    file.write_bytes({"gone": b"", "cut": data[: len(data) // 2], "nonsense": b"[]"}[damage])
    if damage == "gone":
        file.unlink()
    assert cache.load(KEY) is None


def test_a_failure_is_cached_with_its_traceback_and_without_metrics(cache: RunCache) -> None:
    cache.save(KEY, RunOutcome(RunState.ERROR, error="no", details="Traceback\n"), {})
    assert cache.load(KEY) == RunOutcome(RunState.ERROR, error="no", details="Traceback\n")
    assert sorted(path.name for path in cache.path.iterdir()) == [DETAILS_FILE, RESULT_FILE]
    cache.save(KEY, CRASH, {})
    assert cache.load(KEY) == CRASH


def test_a_run_without_a_pose_is_loaded(cache: RunCache) -> None:
    cache.save(KEY, make_outcome(WALK, lost=range(FRAMES)), {})
    loaded = cache.load(KEY)
    assert loaded is not None
    assert (loaded.run.failed, len(loaded.run.trajectory)) == (FRAMES, 0)
    assert isinstance(loaded.run.trajectory, Trajectory)


def test_a_full_disk_leaves_no_result_and_is_not_an_input_error(tmp_path: Path) -> None:
    cache = RunCache(tmp_path)
    with limit_file_size(1000), pytest.raises(UserFacingError, match="the disk is full") as caught:
        cache.save(KEY, make_outcome(WALK), {})
    assert caught.value.exit_code == 1
    assert cache.load(KEY) is None
