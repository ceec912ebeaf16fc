"""CPU time of the odometry by stage: budgets, other features, and SURF."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.odometry import (
    FEATURE_METHODS,
    WHOLE_FRAME,
    StageTiming,
    compare_with_budget,
    make_odometry,
    measure_method,
)
from tests.forked_process import run_module
from tests.vo_service.odometry.synthetic_views import make_frame, render_corner
from vo_service.odometry import stage_timers
from vo_service.types.odometry import NullStageTimer

FRAMES_MS = [{"align": 2.0, WHOLE_FRAME: 3.0}] * 3 + [{"align": 6.0, "odd": 4.0, WHOLE_FRAME: 10.0}]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run_module("benchmarks", "odometry", *arguments)


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, StageTiming]:
    """Stages with a budget of 2.5 ms for align, and 5 ms for a stage that never runs."""
    monkeypatch.setitem(stage_timers.STAGE_BUDGETS_MS, "slow", {"align": 2.5, "rest": 5.0})
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
    lines = [spent.format_row(name) for name, spent in stages.items()]
    assert [line.endswith("  OVER") for line in lines] == [True, False, False]


def test_a_stage_over_its_budget_is_exit_code_1(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(stage_timers.STAGE_BUDGETS_MS, "direct", {"images": 1e6, "align": 1e-9})
    assert main(["odometry", "budget", str(recording)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == [
        str(recording),
        "stage         frames  median    99 %    most    mean  budget   share",
    ]
    assert [line.split()[:2] for line in lines[2:4]] == [["images", "12"], ["align", "11"]]


def test_stages_within_their_budget_pass(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(stage_timers.STAGE_BUDGETS_MS, "direct", {"images": 1e6})
    assert main(["odometry", "budget", str(recording)]) == 0


@pytest.mark.parametrize("method", FEATURE_METHODS)
def test_each_kind_of_features_is_measured(recording: Path, method: str) -> None:
    result = measure_method(method, recording)
    assert (result.frames, result.failed) == (12, 0)
    assert result.evaluation is not None
    assert 0 < result.evaluation.ate_rmse_m < 0.02
    assert list(result.stage_ms) == [
        "surf",
        "points",
        "match",
        "ransac",
        "svd",
        "verify",
        WHOLE_FRAME,
    ]
    assert min(result.stage_ms.values()) > 0


@pytest.mark.subprocess
def test_the_table_has_a_row_for_each_kind(recording: Path) -> None:
    result = run("features", str(recording), "--methods", "SURF", "SIFT")
    first_words = [line.split()[0] for line in result.stdout.splitlines() if line]
    assert first_words == [str(recording), "frames", "SURF", "SIFT"]


@pytest.mark.subprocess
@pytest.mark.parametrize("variant", ["budget", "features", "surf"])
def test_a_missing_folder_is_a_clear_error(tmp_path: Path, variant: str) -> None:
    result = run(variant, str(tmp_path / "missing"))
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1
    assert "missing" in result.stderr


def test_every_stage_of_surf_is_measured(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["odometry", "surf", str(recording), "--frames", "2"]) == 0
    _, *lines = capsys.readouterr().out.splitlines()
    stages = [line.rsplit(maxsplit=1) for line in lines]
    names = [name for name, _ in stages]
    assert names[:2] == ["integral image", "lobe 5, every 1 px"]
    assert names[-5:] == [
        *("lobe 25, every 4 px", "selection", "image pyramid", "descriptors", "whole"),
    ]
    assert min(float(spent_ms) for _, spent_ms in stages) > 0


@pytest.mark.parametrize("method", FEATURE_METHODS)
def test_every_method_accepts_a_black_image(method: str) -> None:
    odometry = make_odometry(method, NullStageTimer())
    view = render_corner(np.eye(4))
    black = make_frame(np.zeros_like(view.gray), view.depth_m.astype(np.float64))
    assert [odometry.estimate(f).ok for f in (view, black, view)] == [True, False, True]


@pytest.mark.parametrize("method", FEATURE_METHODS)
def test_descriptors_are_integers_that_float32_multiplies_exactly(method: str) -> None:
    odometry = make_odometry(method, NullStageTimer())
    descriptor = odometry._extractor.extract(render_corner(np.eye(4)).gray).descriptor
    assert len(descriptor) > 100
    assert descriptor.dtype == np.float32
    assert np.array_equal(descriptor, np.rint(descriptor))
    assert (descriptor.astype(np.float64) ** 2).sum(axis=1).max() < 2**23
