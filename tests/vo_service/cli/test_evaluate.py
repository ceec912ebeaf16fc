"""``kinect-vo evaluate`` as it is typed."""

import json
from pathlib import Path

import pytest

from drivers.core.geometry import Trajectory, format_pose_line, read_trajectory
from tests.vo_service.cli.cli_runner import run_in_process, run_subprocess

KEYS = {
    "frames", "failed", "skipped", "coverage", "stage_ms", "cpu_ms_per_frame",
    "ate_rmse_m", "ate_mean_m", "ate_median_m", "ate_max_m", "mean_global_error_m",
    "rpe_frame_m", "rpe_frame_deg", "rpe_1s_m", "rpe_1s_deg", "poses", "matched",
}  # fmt: skip

Capture = pytest.CaptureFixture[str]


def write(path: Path, poses: Trajectory) -> Path:
    path.write_text("".join(map(format_pose_line, poses.stamps_s, poses.T_world_camera)))
    return path


@pytest.fixture
def half(recording: Path, tmp_path: Path) -> Path:
    """Every other pose of the recording's truth, as a trajectory."""
    truth = read_trajectory(recording / "groundtruth.txt")
    return write(tmp_path / "half.txt", Trajectory(truth.stamps_s[::2], truth.T_world_camera[::2]))


@pytest.mark.subprocess
def test_json_is_one_object_with_every_key(half: Path, recording: Path) -> None:
    outcome = run_subprocess("evaluate", half, recording, "--json")
    assert (outcome.code, outcome.error_lines) == (0, "")
    figures = json.loads(outcome.out)
    assert set(figures) == KEYS
    assert (figures["frames"], figures["poses"], figures["matched"]) == (12, 6, 6)
    assert figures["coverage"] == 0.5
    assert figures["ate_rmse_m"] == pytest.approx(0, abs=1e-6)
    assert figures["rpe_1s_m"] is None


def test_the_folder_and_its_ground_truth_file_give_the_same_result(
    half: Path, recording: Path, capfd: Capture
) -> None:
    of_folder = run_in_process(capfd, "evaluate", half, recording)
    of_file = run_in_process(capfd, "evaluate", half, recording / "groundtruth.txt")
    assert of_folder == of_file
    assert "coverage                50.0 %" in of_folder.out


def test_the_frames_are_those_listed_in_the_recording(
    half: Path, recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    for name in ("groundtruth.txt", "rgb.txt", "depth.txt"):
        lines = (recording / name).read_text().splitlines(keepends=True)
        few = lines if name == "groundtruth.txt" else lines[:9]  # a heading and 8 frames
        (tmp_path / name).write_text("".join(few))
    figures = json.loads(run_in_process(capfd, "evaluate", half, tmp_path, "--json").out)
    assert figures["frames"] == 8
    assert figures["coverage"] == 6 / 8


def test_a_truth_file_counts_as_frames_if_the_stamps_agree(
    half: Path, recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    truth = read_trajectory(recording / "groundtruth.txt")
    alone = write(tmp_path / "truth.txt", truth)
    figures = json.loads(run_in_process(capfd, "evaluate", half, alone, "--json").out)
    assert (figures["frames"], figures["coverage"]) == (None, 0.5)
    shifted = write(tmp_path / "late.txt", Trajectory(truth.stamps_s + 0.004, truth.T_world_camera))
    assert (
        json.loads(run_in_process(capfd, "evaluate", half, shifted, "--json").out)["coverage"]
        is None
    )


def test_a_figure_is_drawn(half: Path, recording: Path, tmp_path: Path, capfd: Capture) -> None:
    outcome = run_in_process(
        capfd, "evaluate", half, recording, "--json", "--picture", tmp_path / "walk.png"
    )
    assert set(json.loads(outcome.out)) == KEYS
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_poses_of_another_time_are_one_line(
    half: Path, recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    poses = read_trajectory(half)
    later = write(tmp_path / "later.txt", Trajectory(poses.stamps_s + 100, poses.T_world_camera))
    outcome = run_in_process(capfd, "evaluate", later, recording)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1
    assert f"{later} against {recording / 'groundtruth.txt'}: 0 of 6 poses have" in outcome.err


@pytest.mark.parametrize("swapped", [False, True])
def test_a_missing_file_is_one_line(half: Path, capfd: Capture, swapped: bool) -> None:
    files = [half, half.parent / "gone.txt"]
    outcome = run_in_process(capfd, "evaluate", *(reversed(files) if swapped else files))
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.endswith("gone.txt: cannot read the trajectory: No such file or directory\n")


def test_an_unwritable_figure_is_one_line(
    half: Path, recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    outcome = run_in_process(
        capfd, "evaluate", half, recording, "--picture", tmp_path / "gone" / "walk.png"
    )
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert "cannot write the figure" in outcome.err
