"""``kinect-vo evaluate`` as it is typed."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core.geometry import Trajectory, format_pose_line, read_trajectory
from tests.drivers.core.test_trajectory_files import as_redwood
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line, run_subprocess

KEYS = {
    "frames", "failed", "skipped", "coverage", "stage_ms", "cpu_ms_per_frame",
    "ate_rmse_m", "ate_mean_m", "ate_median_m", "ate_max_m", "mean_global_error_m",
    "rpe_frame_m", "rpe_frame_deg", "rpe_1s_m", "rpe_1s_deg", "poses", "matched",
}  # fmt: skip


def write(path: Path, poses: Trajectory) -> Path:
    path.write_text("".join(map(format_pose_line, poses.stamps_s, poses.T_world_camera)))
    return path


@pytest.fixture
def half(recording: Path, tmp_path: Path) -> Path:
    """Every other pose of the recording's truth, as a trajectory."""
    truth = read_trajectory(recording / "groundtruth.txt")
    return write(tmp_path / "half.txt", Trajectory(truth.stamps_s[::2], truth.T_world_camera[::2]))


@pytest.mark.subprocess
def test_json_is_one_object_with_every_key_and_a_figure_is_drawn(
    half: Path, recording: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "walk.png"
    outcome = run_subprocess("evaluate", half, recording, "--json", "--picture", picture)
    assert (outcome.code, outcome.error_lines) == (0, "")
    figures = json.loads(outcome.out)
    assert set(figures) == KEYS
    assert (figures["frames"], figures["poses"], figures["matched"]) == (12, 6, 6)
    assert figures["coverage"] == 0.5
    assert figures["ate_rmse_m"] == pytest.approx(0, abs=1e-6)
    assert figures["rpe_1s_m"] is None
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_folder_and_its_ground_truth_file_give_the_same_result(
    half: Path, recording: Path, kinect_vo: KinectVo
) -> None:
    of_folder = kinect_vo("evaluate", half, recording)
    of_file = kinect_vo("evaluate", half, recording / "groundtruth.txt")
    assert of_folder == of_file
    assert "coverage                50.0 %" in of_folder.out


def test_the_frames_are_those_listed_in_the_recording(
    half: Path, recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    for name in ("groundtruth.txt", "rgb.txt", "depth.txt"):
        lines = (recording / name).read_text().splitlines(keepends=True)
        few = lines if name == "groundtruth.txt" else lines[:9]  # a heading and 8 frames
        (tmp_path / name).write_text("".join(few))
    figures = json.loads(kinect_vo("evaluate", half, tmp_path, "--json").out)
    assert figures["frames"] == 8
    assert figures["coverage"] == 6 / 8


def test_poses_of_another_time_are_one_line(
    half: Path, recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    poses = read_trajectory(half)
    later = write(tmp_path / "later.txt", Trajectory(poses.stamps_s + 100, poses.T_world_camera))
    outcome = kinect_vo("evaluate", later, recording)
    files = f"{later} against {recording / 'groundtruth.txt'}"
    assert_one_line(outcome, 2, f"{files}: 0 of 6 poses have")
    assert "s apart); use the truth of the same recording" in outcome.err
    assert outcome.err.endswith(", or give --time-offset or --max-difference\n")


@pytest.mark.parametrize(
    ("late_s", "options"),
    [(100.0, ["--time-offset", "-100"]), (0.03, ["--max-difference", "0.031"])],
)
def test_clocks_that_differ_are_matched_on_request(
    half: Path,
    recording: Path,
    tmp_path: Path,
    kinect_vo: KinectVo,
    late_s: float,
    options: list[str],
) -> None:
    poses = read_trajectory(half)
    late = write(tmp_path / "late.txt", Trajectory(poses.stamps_s + late_s, poses.T_world_camera))
    outcome = kinect_vo(
        "evaluate", late, recording, "--json", "--picture", tmp_path / "late.png", *options
    )
    figures = json.loads(outcome.out)
    assert figures["matched"] >= 5
    assert figures["ate_rmse_m"] < 0.02


def test_ground_truth_of_another_benchmark_is_recognized(
    half: Path, copy_recording: Callable[..., Path], kinect_vo: KinectVo
) -> None:
    folder = copy_recording(lists=True)
    truth = read_trajectory(folder / "groundtruth.txt")
    (folder / "groundtruth.txt").unlink()
    file = folder / "trajectory.log"
    file.write_text(as_redwood(truth.T_world_camera))
    for path in (folder, file):
        outcome = kinect_vo("evaluate", half, path, "--json")
        assert (outcome.code, outcome.error_lines) == (0, ""), outcome.err
        assert f"{file}: Redwood format, stamps of the frames" in outcome.err
        figures = json.loads(outcome.out)
        assert (figures["matched"], figures["frames"]) == (6, 12)
        assert figures["ate_rmse_m"] == pytest.approx(0, abs=1e-6)


def test_a_folder_without_true_poses_is_refused(
    half: Path, copy_recording: Callable[..., Path], kinect_vo: KinectVo
) -> None:
    folder = copy_recording(lists=True)
    (folder / "groundtruth.txt").unlink()
    message = f"{folder}: has no true poses (groundtruth.txt, groundtruth.csv, "
    assert_one_line(kinect_vo("evaluate", half, folder), 2, message)
