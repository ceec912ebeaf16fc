"""``reconstruct`` over a small recording: what it leaves, what it refuses, Ctrl-C."""

import json
import os
import shutil
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, Trajectory, format_trajectory, read_trajectory
from tests.conftest import FRAMES
from tests.full_disk import limit_file_size
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line, documented_json_keys
from tests.vo_service.odometry.synthetic_views import FLOOR, WALL
from tests.vo_service.reconstruction.ply_reader import read_ply
from vo_service.reconstruction.reconstructor import Reconstructor

CopyRecording = Callable[..., Path]
PICTURES = ("perspective.png", "top.png", "view.png")
FILES = sorted((*PICTURES, "map.ply", "reconstruction.json"))
COARSE = ("--voxel-m", 0.04, "--memory-mb", 100)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "output"


@pytest.fixture
def reconstruct(recording: Path, output: Path, kinect_vo: KinectVo) -> KinectVo:
    """``reconstruct(...)`` along the recording's true trajectory into `output`."""
    truth = recording / "groundtruth.txt"
    return partial(kinect_vo, "reconstruct", recording, truth, "--output", output)


def names(folder: Path) -> list[str]:
    """Of its files; the compiled kernels' cache apart."""
    there = folder.iterdir() if folder.exists() else ()
    return sorted(path.name for path in there if path.name != "cache")


def off_corner_m(points_m: Array) -> Array:
    """Distance of points to the nearer of the two planes that the recording shows."""
    off = [(points_m @ normal - d) / np.linalg.norm(normal) for normal, d in (WALL, FLOOR)]
    nearer: Array = np.min(np.abs(off), axis=0)
    return nearer


def likeness(one: Path, other: Path) -> float:
    """Correlation of two images, apart from their rims and finest detail; 1 is the same."""
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (one, other)]
    a, b = (
        cv2.GaussianBlur(image, (0, 0), 4)[30:-30, 30:-30].astype(np.float64).ravel()
        for image in images
        if image is not None
    )
    return float(np.corrcoef(a, b)[0, 1])


@pytest.mark.rerun
def test_a_given_trajectory_gives_a_map_in_its_world(
    recording: Path, tmp_path: Path, reconstruct: KinectVo
) -> None:
    output, rerun = tmp_path / "maps" / "corner", tmp_path / "map.rrd"
    outcome = reconstruct("--output", output, "--rerun", rerun, "--voxel-m", 0.02)
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert f"in the map             {FRAMES}" in outcome.out
    assert names(output) == FILES
    mesh = read_ply(output / "map.ply")
    assert np.median(off_corner_m(mesh.vertices_m.astype(np.float64))) < 0.005
    for name in PICTURES:
        picture = cv2.imread(str(output / name))
        assert picture is not None
        assert picture.std() > 10
    # What the camera would see of the map is what it saw.
    assert likeness(output / "view.png", min((recording / "rgb").iterdir())) > 0.8
    assert rerun.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.usefixtures("no_top_view")
def test_without_a_trajectory_the_odometry_runs_and_its_trajectory_is_written(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo("reconstruct", recording, "--output", tmp_path, "--json", *COARSE)
    assert (outcome.code, outcome.error_lines, outcome.out.count("\n")) == (0, "", 1)
    figures = json.loads(outcome.out)
    assert json.loads((tmp_path / "reconstruction.json").read_text()) == figures
    assert set(figures) <= documented_json_keys()
    assert (figures["frames"], figures["fused"], figures["without_pose"]) == (FRAMES, FRAMES, 0)
    assert (figures["cut_short"], figures["full_at_frame"]) == (False, None)
    assert names(tmp_path) == sorted([*FILES, "trajectory.txt"])
    np.testing.assert_array_equal(
        read_trajectory(tmp_path / "trajectory.txt").T_world_camera[0], np.eye(4)
    )
    assert len(read_ply(tmp_path / "map.ply").triangles) == figures["triangles"] > 1000


@pytest.mark.slow
@pytest.mark.usefixtures("no_top_view")
def test_the_trajectory_of_an_earlier_map_does_not_stay_beside_one_of_other_poses(
    recording: Path, output: Path, kinect_vo: KinectVo, reconstruct: KinectVo
) -> None:
    output.mkdir()
    (output / "trajectory.txt").write_text("of an earlier map\n")
    assert reconstruct(*COARSE).code == 0
    assert not (output / "trajectory.txt").exists()
    given = Path(shutil.copy(recording / "groundtruth.txt", output / "trajectory.txt"))
    assert kinect_vo("reconstruct", recording, given, "--output", output, *COARSE).code == 0
    assert given.read_bytes() == (recording / "groundtruth.txt").read_bytes()


@pytest.mark.parametrize("option", ["--loop-closure", "--method=icp", "--timing=fixed"])
def test_an_option_of_the_odometry_with_a_given_trajectory_is_rejected(
    recording: Path, output: Path, reconstruct: KinectVo, option: str
) -> None:
    truth, name = recording / "groundtruth.txt", option.partition("=")[0]
    message = f"{truth}: {name} works only on the odometry's own poses"
    assert_one_line(reconstruct(option), 2, message)
    assert not output.exists()


@pytest.mark.slow
@pytest.mark.usefixtures("no_top_view")
def test_a_full_map_is_a_warning_and_still_written(output: Path, reconstruct: KinectVo) -> None:
    outcome = reconstruct("--voxel-m", 0.01, "--memory-mb", 20, "--json")
    # On a slow machine, progress comes besides.
    warnings = [line for line in outcome.error_lines.splitlines() if "warning: " in line]
    assert (outcome.code, len(warnings)) == (0, 1)
    assert "the map was full at frame 1 of 12: surfaces seen later are left out" in outcome.err
    assert "--memory-mb 20, or larger voxels than --voxel-m 0.01" in outcome.err
    assert json.loads(outcome.out)["full_at_frame"] == 1
    assert len(read_ply(output / "map.ply").triangles) > 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--voxel-m", "0"), "--voxel-m: 0 is not a length: give 0.002 to 0.5"),
        (("--voxel-m", "nan"), "--voxel-m: nan is not a length"),
        (("--memory-mb", "5"), "--memory-mb: 5 is not a size: give 20 or more"),
        (("--memory-mb", "1e3"), "--memory-mb: 1e3 is not a size"),
        (("--memory-mb", "9000000"), "--memory-mb 9000000: this computer does not have it"),
        (("--max-depth-m", "-1"), "--max-depth-m: -1 is not a length"),
        (("--rerun", "nowhere"), "rerun target 'nowhere'"),
        (("nowhere.txt",), "nowhere.txt: cannot be read"),
    ],
)
def test_command_line_errors_are_one_line(
    recording: Path, kinect_vo: KinectVo, tmp_path: Path,
    given: tuple[str, ...], message: str
) -> None:  # fmt: skip
    output = ("--output", tmp_path / "output")
    assert_one_line(kinect_vo("reconstruct", recording, *given, *output), 2, message)
    assert names(tmp_path) == []


def test_a_trajectory_of_another_recording_is_refused(
    recording: Path, tmp_path: Path, output: Path, kinect_vo: KinectVo
) -> None:
    other = tmp_path / "other.txt"
    other.write_text("500.0 0 0 0 0 0 0 1\n500.1 0 0 0 0 0 0 1\n")
    outcome = kinect_vo("reconstruct", recording, other, "--output", output)
    assert_one_line(outcome, 2, f"{other}: has no pose within 20 ms of any frame of {recording}")
    assert "(poses 500.000..500.100 s, frames 0.000..0.367 s)" in outcome.err
    assert not output.exists()


@pytest.mark.usefixtures("no_top_view")
def test_poses_in_millimeters_are_named(
    recording: Path, tmp_path: Path, output: Path, kinect_vo: KinectVo
) -> None:
    poses = read_trajectory(recording / "groundtruth.txt")
    T_world_camera = poses.T_world_camera.copy()
    T_world_camera[:, 0, 3] += 1000.0 * poses.stamps_s
    file = tmp_path / "poses.txt"
    file.write_bytes(format_trajectory(Trajectory(poses.stamps_s, T_world_camera)))
    outcome = kinect_vo("reconstruct", recording, file, "--output", output, "--voxel-m", "0.2")
    assert f"{file}: the camera moves at" in outcome.err


def test_a_recording_without_depth_is_refused(
    blind_recording: Path, output: Path, kinect_vo: KinectVo
) -> None:
    folder = blind_recording
    truth = kinect_vo("reconstruct", folder, folder / "groundtruth.txt", "--output", output)
    assert_one_line(truth, 2, f"no depth up to 4 m in any of {FRAMES} frames")
    odometry = kinect_vo("reconstruct", folder, "--output", output)
    assert_one_line(odometry, 1, f"none of {FRAMES} frames could be tracked")
    assert names(output) == []


@pytest.mark.slow
@pytest.mark.usefixtures("no_top_view")
def test_ctrl_c_writes_the_map_of_the_frames_so_far(
    output: Path, reconstruct: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = Reconstructor.add_frame

    def interrupted(self: Reconstructor, frame: RgbdFrame) -> None:
        add(self, frame)
        if self.result.frames == 5:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Reconstructor, "add_frame", interrupted)
    outcome = reconstruct("--json", *COARSE)
    figures = json.loads(outcome.out)
    assert (outcome.code, figures["frames"], figures["cut_short"]) == (130, 5, True)
    assert names(output) == FILES


@pytest.mark.slow
def test_a_second_ctrl_c_ends_the_process_because_kernels_must_not_raise(
    output: Path, reconstruct: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    exit_codes: list[int] = []

    def stop_twice(self: Reconstructor) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    def end_process(code: int) -> None:
        exit_codes.append(code)
        raise SystemExit(code)

    monkeypatch.setattr(Reconstructor, "finish", stop_twice)
    monkeypatch.setattr("os._exit", end_process)
    reconstruct(*COARSE)
    assert exit_codes == [130]
    assert names(output) == []


def test_a_full_disk_is_one_line_and_leaves_no_partial_file(
    output: Path, reconstruct: KinectVo
) -> None:
    with limit_file_size(20_000):
        outcome = reconstruct(*COARSE)
    assert_one_line(outcome, 1, f"{output / 'map.ply'}: the disk is full")
    assert names(output) == []
