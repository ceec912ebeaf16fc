"""Changes of a recording: tiny, wrong and corrupted, and the tables of their errors."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.changed_recordings import (
    CORRUPTIONS,
    MAX_DELAY_ERROR_S,
    MAX_FOCAL_ERROR_PX,
    Corruption,
    SwingMotion,
    format_spread,
    make_other_sensors,
    make_perturbation,
    rotate,
)
from benchmarks.harness import Json
from drivers.camera import RgbdFrame
from drivers.core.geometry import rigid_transform
from drivers.faulty_camera import Fault, FaultKind
from tests.forked_process import run_module
from tests.vo_service.fakes import make_frame
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.surf.odometry import SurfOdometry


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
def test_finished_runs_are_stored_and_not_repeated(recording: Path, tmp_path: Path) -> None:
    command = ("tiny", str(tmp_path), str(recording), "--method", "surf", "--count", "2")
    first = run(*command)
    assert first.returncode == 0, first.stderr
    assert float(rows(first.stdout)[3][1]) < 20.0
    stored = json.loads((tmp_path / "results.json").read_text())
    assert len(stored) == 3
    for key in stored:
        stored[key]["ate_m"] = 0.123
    (tmp_path / "results.json").write_text(json.dumps(stored))
    assert rows(run(*command).stdout)[3] == ["ATE", *["123.00"] * 4, "1.00"]


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


@pytest.fixture(scope="module")
def still() -> list[RgbdFrame]:
    """Frames of a stationary camera."""
    return [render_corner(np.eye(4), seq) for seq in range(8)]


def test_pieces_are_evenly_spread_and_the_rest_is_unchanged(still: list[RgbdFrame]) -> None:
    missing = Corruption(FaultKind.DROPPED, frames=2, pieces=2)
    assert missing.first_frames(8) == [1, 5]
    assert missing.faults(8)[1] == Fault(FaultKind.DROPPED, 5, 2)
    swung = Corruption(SwingMotion((0.0, 0.3, 0.0), 1.0, 0.0), 2, 2).swing(still, 8)
    unchanged = [frame is before for frame, before in zip(swung, still, strict=True)]
    assert unchanged == [n not in (1, 2, 5, 6) for n in range(8)]


@pytest.mark.slow
def test_a_swing_moves_the_view(still: list[RgbdFrame]) -> None:
    swing = SwingMotion((0.04, 0.15, 0.03), rate_hz=1.0, exposure_s=0.0)
    estimates = estimate_all(SurfOdometry(), [rotate(f, swing, f.stamp_s) for f in still])
    for frame, estimate in zip(still, estimates, strict=True):
        turned = rigid_transform(swing.rotation_at(frame.stamp_s), np.zeros(3))
        assert estimate.ok
        assert_close(estimate.T_world_camera, turned, 0.01, 0.4)


def test_an_open_shutter_blurs_a_swing(still: list[RgbdFrame]) -> None:
    sharp, blurred = (
        rotate(still[0], SwingMotion((0.0, 0.3, 0.0), 1.0, exposure_s), 0.0)
        for exposure_s in (0.0, 0.03)
    )
    assert np.abs(np.diff(blurred.gray.astype(int))).mean() < 0.7 * (
        np.abs(np.diff(sharp.gray.astype(int))).mean()
    )


def test_every_corruption_leaves_most_of_half_a_minute_intact() -> None:
    for damage in CORRUPTIONS.values():
        assert damage.frames * damage.pieces <= 120


@pytest.mark.parametrize(("name", "factor"), [("half the size", 0.5), ("twice the size", 2.0)])
def test_another_size_has_the_same_rays(name: str, factor: float) -> None:
    frame = render_corner(np.eye(4))
    other = make_other_sensors()[name](frame)
    assert other.depth_raw.shape == other.color_bgr.shape[:2]
    assert other.camera.width == factor * frame.camera.width
    step = max(1, round(1 / factor))
    ray = (np.arange(0, frame.camera.width, step) - frame.camera.cx) / frame.camera.fx
    u = factor * np.arange(0, frame.camera.width, step) + (0.5 if factor > 1 else 0.0)
    np.testing.assert_allclose((u - other.camera.cx) / other.camera.fx, ray, atol=1e-9)


def test_the_noise_of_another_sensor_has_the_size_of_its_name() -> None:
    frame = render_corner(np.eye(4))
    other = make_other_sensors()["noise 0.006 1/m, 6 px"](frame)
    noise = 1.0 / other.depth_m - 1.0 / frame.depth_m
    assert noise.std() == pytest.approx(0.006, rel=0.05)
    assert np.corrcoef(noise[:, :-3].ravel(), noise[:, 3:].ravel())[0, 1] > 0.8
