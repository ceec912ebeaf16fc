"""CPU time of each stage, compared with its budget."""

import json
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.stage_budget import WHOLE_FRAME, StageTiming, compare_with_budget, format_stages
from vo_service import odometry

FRAMES_MS = [{"align": 2.0, WHOLE_FRAME: 3.0}] * 3 + [{"align": 6.0, "odd": 4.0, WHOLE_FRAME: 10.0}]


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, StageTiming]:
    """Stages with a budget of 2.5 ms for align, and 5 ms for a stage that never runs."""
    monkeypatch.setitem(odometry.STAGE_BUDGETS_MS, "slow", {"align": 2.5, "rest": 5.0})
    return compare_with_budget("slow", FRAMES_MS)


def test_means_are_over_all_frames_and_other_figures_over_frames_with_the_stage(
    stages: dict[str, StageTiming],
) -> None:
    assert list(stages) == ["align", "odd", WHOLE_FRAME]
    assert stages["odd"] == StageTiming(1, 4.0, 4.0, 4.0, 1.0, None)
    assert (stages["align"].median, stages["align"].max, stages["align"].mean) == (2.0, 6.0, 3.0)


def test_an_exceeded_budget_is_reported_and_the_whole_frame_has_the_sum(
    stages: dict[str, StageTiming],
) -> None:
    assert [name for name, spent in stages.items() if spent.is_over] == ["align"]
    assert stages[WHOLE_FRAME].budget == 7.5
    lines = format_stages(stages).splitlines()
    assert [line.endswith("  OVER") for line in lines] == [False, True, False, False]


def run(*arguments: str) -> int:
    return main(["stage_budget", *arguments])


def test_a_recording_is_measured(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(odometry.STAGE_BUDGETS_MS, "direct", {"images": 1e6, "align": 1e-9})
    assert run(str(recording), "--json") == 1
    stages = json.loads(capsys.readouterr().out)[str(recording)]
    assert (stages["images"]["frames"], stages["align"]["frames"]) == (12, 11)
    assert 0 < stages["align"]["mean"] < stages[WHOLE_FRAME]["mean"]


def test_every_nth_frame_within_its_budget_passes(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(odometry.STAGE_BUDGETS_MS, "direct", {"images": 1e6})
    assert run(str(recording), "--every", "4") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[2:4]] == [["images", "3"], ["align", "2"]]


def test_a_missing_folder_is_a_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(tmp_path / "missing")) == 2
    assert capsys.readouterr().err.count("\n") == 1
