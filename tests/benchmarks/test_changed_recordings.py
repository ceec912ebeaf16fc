"""Changes of a recording: tiny, wrong and corrupted, and the tables of their errors."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.changed_recordings import (
    MAX_DELAY_ERROR_S,
    MAX_FOCAL_ERROR_PX,
    format_spread,
    make_perturbation,
)
from benchmarks.harness import Json
from tests.forked_process import run_module
from tests.vo_service.fakes import make_frame


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run_module("benchmarks", "changed_recordings", *arguments)


def result(ate_m: float | None, failed: int = 0) -> Json:
    return {"ate_m": ate_m, "rpe_1s_m": None, "failed": failed}


def rows(table: str) -> list[list[str]]:
    return [line.split() for line in table.splitlines()]


def test_a_perturbation_is_tiny_and_the_same_in_every_run() -> None:
    frame = make_frame(3)
    frame.color_bgr[:] = 128
    changed, again, other = (make_perturbation(seed).apply(frame) for seed in (1, 1, 2))
    np.testing.assert_array_equal(changed.color_bgr, again.color_bgr)
    assert np.any(changed.color_bgr != other.color_bgr)
    assert set(np.unique(changed.color_bgr)) == {127, 128, 129}
    assert 0 < abs(changed.camera.fx - frame.camera.fx) <= MAX_FOCAL_ERROR_PX
    assert 0 < abs(changed.skew_s) <= MAX_DELAY_ERROR_S


def test_noise_does_not_wrap_around_at_black_and_differs_between_frames() -> None:
    first, second = (make_perturbation(1).apply(make_frame(seq)).color_bgr for seq in (0, 1))
    assert first.max() == 1
    assert np.any(first != second)


def test_the_ratio_is_that_of_the_largest_to_the_smallest_error() -> None:
    table = format_spread("direct", result(0.002), [result(0.003), result(0.001), result(0.002, 4)])
    ate, rpe, failed = rows(table)[2:]
    assert ate == ["ATE", "2.00", "1.00", "2.00", "3.00", "3.00"]
    assert rpe == ["RPE/1s", "-", "-", "-", "-", "-"]
    assert failed == ["failed", "0", "0", "0", "4", "-"]


def test_a_perturbed_run_without_error_has_no_ratio() -> None:
    table = format_spread("direct", result(0.002), [result(0.003), result(None, 9)])
    assert rows(table)[2] == ["ATE", "2.00", "-", "-", "-", "-"]


@pytest.mark.slow
@pytest.mark.subprocess
def test_tiny_changes_of_a_recording_are_measured(recording: Path, tmp_path: Path) -> None:
    command = ("tiny", str(tmp_path), str(recording), "--method", "surf", "--count", "2")
    ended = run(*command)
    assert ended.returncode == 0, ended.stderr
    assert float(rows(ended.stdout)[3][1]) < 20.0


@pytest.mark.slow
@pytest.mark.subprocess
def test_each_wrong_calibration_and_corruption_has_a_row(recording: Path) -> None:
    calibration = run("calibration", str(recording), "--method", "surf")
    assert calibration.returncode == 0, calibration.stderr
    lines = calibration.stdout.splitlines()
    assert lines[1].split() == ["ATE", "global", "RPE/1s", "failed"]
    assert lines[2].startswith("correct ")
    assert len(lines) == 14


@pytest.mark.subprocess
def test_a_recording_without_truth_is_a_clear_error(
    tmp_path: Path, copy_recording: Callable[..., Path]
) -> None:
    folder = copy_recording()
    (folder / "groundtruth.txt").unlink()
    ended = run("tiny", str(tmp_path / "kept"), str(folder))
    assert ended.returncode == 2
    assert ended.stderr.splitlines() == [
        f"error: {folder}: has no groundtruth.txt; name a recording with one"
    ]
