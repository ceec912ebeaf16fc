"""What is kept of a run comes back the same, or not at all."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError, UserFacingError
from drivers.trajectory import StampedPoses
from tests.full_disk import files_up_to
from tests.vo_service.runs.made_up import CRASH, FRAMES, along_x, done, loops_run, recording
from vo_service.runs.keeping import CORRECTED, DETAILS, RESULT, TRAJECTORY, RunFolder
from vo_service.runs.keeping import FRAMES as FRAMES_FILE
from vo_service.runs.run import FrameLog, Outcome, RunState

KEY = "abc"
WALK = recording("walk")


@pytest.fixture
def kept(tmp_path: Path) -> RunFolder:
    """A folder with a run that lost frames 5 to 9."""
    folder = RunFolder(tmp_path / "walk" / "surf")
    folder.save(KEY, done(recording(), lost=range(5, 10), epoch_from=30), {"method": "surf"})
    return folder


def test_a_run_comes_back_as_it_was(kept: RunFolder) -> None:
    found, before = kept.load(KEY), done(recording(), lost=range(5, 10), epoch_from=30)
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
def looped(tmp_path: Path) -> RunFolder:
    """A folder with a run that has a corrected trajectory beside its own."""
    folder = RunFolder(tmp_path / "walk" / "surf")
    folder.save(KEY, done(WALK, step_m=0.02, with_loops=loops_run(WALK)), {})
    return folder


def test_what_loops_made_of_a_run_comes_back_too(looped: RunFolder) -> None:
    found = looped.load(KEY)
    assert found is not None
    assert found.run.with_loops is not None
    with_loops = found.run.with_loops
    assert (with_loops.places, with_loops.loops, with_loops.cpu_ms) == (3, 2, 1.5)
    np.testing.assert_allclose(with_loops.trajectory.T_world_camera, along_x(FRAMES), atol=1e-6)


def test_a_run_whose_corrected_trajectory_is_cut_or_gone_does_not_count(
    looped: RunFolder,
) -> None:
    file = looped.path / CORRECTED
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-1]))
    assert looped.load(KEY) is None
    file.unlink()
    assert looped.load(KEY) is None


def test_a_run_without_loops_leaves_none_of_those_before(looped: RunFolder) -> None:
    looped.save(KEY, done(WALK), {})
    found = looped.load(KEY)
    assert found is not None
    assert found.run.with_loops is None
    assert not (looped.path / CORRECTED).exists()


def test_result_json_tells_the_figures_that_need_no_truth(kept: RunFolder) -> None:
    result = json.loads((kept.path / RESULT).read_text())
    figures = {name: result[name] for name in ("frames", "failed", "new_epochs", "cpu_s", "method")}
    assert figures == {"frames": 40, "failed": 5, "new_epochs": 1, "cpu_s": 0.32, "method": "surf"}
    assert len((kept.path / TRAJECTORY).read_text().splitlines()) == FRAMES - 5
    assert len((kept.path / FRAMES_FILE).read_text().splitlines()) == FRAMES + 1


def test_a_run_of_another_key_does_not_count(kept: RunFolder) -> None:
    assert kept.load("another") is None
    assert RunFolder(kept.path.parent / "icp").load(KEY) is None


@pytest.mark.parametrize("name", [RESULT, TRAJECTORY, FRAMES_FILE])
@pytest.mark.parametrize("damage", ["gone", "cut", "nonsense"])
def test_a_damaged_run_does_not_count(kept: RunFolder, name: str, damage: str) -> None:
    file = kept.path / name
    data = file.read_bytes()
    file.write_bytes({"gone": b"", "cut": data[: len(data) // 2], "nonsense": b"[]"}[damage])
    if damage == "gone":
        file.unlink()
    assert kept.load(KEY) is None


def test_a_failure_is_kept_with_its_traceback_and_without_figures(kept: RunFolder) -> None:
    kept.save(KEY, Outcome(RunState.RAISED, trouble="no", details="Traceback\n"), {})
    assert kept.load(KEY) == Outcome(RunState.RAISED, trouble="no", details="Traceback\n")
    assert sorted(path.name for path in kept.path.iterdir()) == [DETAILS, RESULT]
    kept.save(KEY, CRASH, {})
    assert kept.load(KEY) == CRASH


def test_a_run_without_a_pose_is_a_run(kept: RunFolder) -> None:
    kept.save(KEY, done(recording(), lost=range(FRAMES)), {})
    found = kept.load(KEY)
    assert found is not None
    assert (found.run.failed, len(found.run.trajectory)) == (FRAMES, 0)
    assert isinstance(found.run.trajectory, StampedPoses)


def test_a_full_disk_leaves_no_result_and_is_no_mistake_of_the_user(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    with files_up_to(1000), pytest.raises(UserFacingError, match=r"cannot be written: ") as caught:
        folder.save(KEY, done(recording()), {})
    assert caught.value.exit_code == 1
    assert folder.load(KEY) is None


def test_a_place_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/surf: cannot be created: .*--output"):
        RunFolder(tmp_path / "file" / "surf").save(KEY, CRASH, {})
