"""What is kept of a run comes back the same, or not at all."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from drivers.core.errors import InputError, UserFacingError
from drivers.core.trajectory import Trajectory
from tests.full_disk import limit_file_size
from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    FRAMES,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    poses_along_x,
)
from vo_service.tools.benchmark.run import FrameLog, RunOutcome, RunState
from vo_service.tools.benchmark.run_cache import (
    DETAILS_FILE,
    OPTIMIZED_TRAJECTORY_FILE,
    RESULT_FILE,
    TRAJECTORY_FILE,
    RunCache,
)
from vo_service.tools.benchmark.run_cache import FRAMES_FILE as FRAMES_FILE

KEY = "abc"
WALK = make_recording("walk")


@pytest.fixture
def kept(tmp_path: Path) -> RunCache:
    """A folder with a run that lost frames 5 to 9."""
    folder = RunCache(tmp_path / "walk" / "surf")
    folder.save(
        KEY, make_outcome(make_recording(), lost=range(5, 10), epoch_from=30), {"method": "surf"}
    )
    return folder


def test_a_run_comes_back_as_it_was(kept: RunCache) -> None:
    found, before = kept.load(KEY), make_outcome(make_recording(), lost=range(5, 10), epoch_from=30)
    assert found is not None
    assert found.state is RunState.DONE
    for field in fields(FrameLog):
        mine, theirs = (getattr(o.run.frames, field.name) for o in (found, before))
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_allclose(
        found.run.trajectory.T_world_camera, before.run.trajectory.T_world_camera, atol=1e-6
    )
    assert (found.run.stage_ms, found.run.memory_mb) == ({"surf": 5.0}, 100.0)


@pytest.fixture
def looped(tmp_path: Path) -> RunCache:
    """A folder with a run that has a corrected trajectory beside its own."""
    folder = RunCache(tmp_path / "walk" / "surf")
    folder.save(KEY, make_outcome(WALK, step_m=0.02, with_loops=make_loop_closure_run(WALK)), {})
    return folder


def test_what_loops_made_of_a_run_comes_back_too(looped: RunCache) -> None:
    found = looped.load(KEY)
    assert found is not None
    assert found.run.loop_closure is not None
    with_loops = found.run.loop_closure
    assert (with_loops.map_keyframes, with_loops.loop_closures, with_loops.cpu_ms_per_frame) == (
        3,
        2,
        1.5,
    )
    np.testing.assert_allclose(
        with_loops.trajectory.T_world_camera, poses_along_x(FRAMES), atol=1e-6
    )


def test_a_run_whose_corrected_trajectory_is_cut_or_gone_does_not_count(
    looped: RunCache,
) -> None:
    file = looped.path / OPTIMIZED_TRAJECTORY_FILE
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-1]))
    assert looped.load(KEY) is None
    file.unlink()
    assert looped.load(KEY) is None


def test_a_run_without_loops_leaves_none_of_those_before(looped: RunCache) -> None:
    looped.save(KEY, make_outcome(WALK), {})
    found = looped.load(KEY)
    assert found is not None
    assert found.run.loop_closure is None
    assert not (looped.path / OPTIMIZED_TRAJECTORY_FILE).exists()


def test_result_json_tells_the_figures_that_need_no_truth(kept: RunCache) -> None:
    result = json.loads((kept.path / RESULT_FILE).read_text())
    figures = {name: result[name] for name in ("frames", "failed", "new_epochs", "cpu_s", "method")}
    assert figures == {"frames": 40, "failed": 5, "new_epochs": 1, "cpu_s": 0.32, "method": "surf"}
    assert len((kept.path / TRAJECTORY_FILE).read_text().splitlines()) == FRAMES - 5
    assert len((kept.path / FRAMES_FILE).read_text().splitlines()) == FRAMES + 1


def test_a_run_of_another_key_does_not_count(kept: RunCache) -> None:
    assert kept.load("another") is None
    assert RunCache(kept.path.parent / "icp").load(KEY) is None


@pytest.mark.parametrize("name", [RESULT_FILE, TRAJECTORY_FILE, FRAMES_FILE])
@pytest.mark.parametrize("damage", ["gone", "cut", "nonsense"])
def test_a_damaged_run_does_not_count(kept: RunCache, name: str, damage: str) -> None:
    file = kept.path / name
    data = file.read_bytes()
    file.write_bytes({"gone": b"", "cut": data[: len(data) // 2], "nonsense": b"[]"}[damage])
    if damage == "gone":
        file.unlink()
    assert kept.load(KEY) is None


def test_a_failure_is_kept_with_its_traceback_and_without_figures(kept: RunCache) -> None:
    kept.save(KEY, RunOutcome(RunState.ERROR, error="no", details="Traceback\n"), {})
    assert kept.load(KEY) == RunOutcome(RunState.ERROR, error="no", details="Traceback\n")
    assert sorted(path.name for path in kept.path.iterdir()) == [DETAILS_FILE, RESULT_FILE]
    kept.save(KEY, CRASH, {})
    assert kept.load(KEY) == CRASH


def test_a_run_without_a_pose_is_a_run(kept: RunCache) -> None:
    kept.save(KEY, make_outcome(make_recording(), lost=range(FRAMES)), {})
    found = kept.load(KEY)
    assert found is not None
    assert (found.run.failed, len(found.run.trajectory)) == (FRAMES, 0)
    assert isinstance(found.run.trajectory, Trajectory)


def test_a_full_disk_leaves_no_result_and_is_no_mistake_of_the_user(tmp_path: Path) -> None:
    folder = RunCache(tmp_path)
    with (
        limit_file_size(1000),
        pytest.raises(UserFacingError, match=r"cannot be written: ") as caught,
    ):
        folder.save(KEY, make_outcome(make_recording()), {})
    assert caught.value.exit_code == 1
    assert folder.load(KEY) is None


def test_a_place_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/surf: cannot be created: .*--output"):
        RunCache(tmp_path / "file" / "surf").save(KEY, CRASH, {})
