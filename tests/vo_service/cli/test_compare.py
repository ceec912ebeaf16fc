"""``kinect-vo compare`` as it is typed."""

import csv
import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core import InputError
from drivers.core.config import read_toml
from tests.conftest import FRAMES
from tests.forked_process import ForkedProcess
from tests.resource_leaks import child_pids_of, command_line_of, find_child_running, is_alive
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.tools.compare.faulty_methods import make_faulty_factories
from tests.waiting import wait_until
from vo_service.cli import compare
from vo_service.config import Config
from vo_service.odometry.registry import METHODS
from vo_service.tools.compare import batch
from vo_service.tools.compare.baselines.registry import BASELINES, BaselinePackage
from vo_service.tools.compare.methods import METHOD_NAMES
from vo_service.tools.compare.report import report_folder

pytestmark = [pytest.mark.subprocess, pytest.mark.usefixtures("forked_runs")]

CopyRecording = Callable[..., Path]
HaveMethods = Callable[..., None]
CHILD = "vo_service.tools.compare.worker_main:run_comparison"


def test_a_comparison_gives_a_report_and_the_poses_of_a_replay(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    output = tmp_path / "report"
    done = kinect_vo("compare", recording, "--methods", "surf", "--output", output, "--json")
    assert (done.code, done.error_lines) == (0, "")
    assert json.loads(done.out) == json.loads((output / "report.json").read_text())
    surf = json.loads(done.out)["sequences"][0]["methods"]["surf"]
    figures = [surf[key] for key in ("state", "frames", "failed", "coverage")]
    assert figures == ["done", FRAMES, 0, 1.0]
    assert 0 < surf["mean_global_error_m"] < 0.003
    assert 0 < surf["cpu_ms_median"] <= surf["cpu_ms_p99"]
    assert (output / "report.html").stat().st_size > 10_000
    replayed = tmp_path / "replayed.txt"
    kinect_vo("replay", recording, "--method", "surf", "--no-publish", "--trajectory", replayed)
    kept = output / "runs" / recording.name / "surf" / "trajectory.txt"
    assert kept.read_bytes() == replayed.read_bytes()


def test_a_method_without_a_pose_fails_and_names_the_reason(
    blind_recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    options = ("--methods", "surf", "--output", tmp_path / "out", "--json")
    done = kinect_vo("compare", blind_recording, *options)
    assert done.code == 1
    assert f"surf: none of {FRAMES} frames could be tracked; the most frequent" in done.err


@pytest.fixture
def have_methods(monkeypatch: pytest.MonkeyPatch) -> HaveMethods:
    """``have_methods(icp="hang")``: the methods are those of `faulty_methods`."""
    return lambda **faults: monkeypatch.setattr(
        compare, "make_method_factories", make_faulty_factories(**faults)
    )


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take most of the time of a report, and have tests of their own."""
    monkeypatch.setattr(report_folder, "make_figures", lambda result: iter(()))


@pytest.mark.usefixtures("no_figures")
def test_a_baseline_is_measured_at_each_rate_and_reported(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    output = tmp_path / "out"
    method = "cv2-rgb-depth"
    options = ("--methods", method, "--against", method, "--every", 1, 3, "--frames", 10)
    done = kinect_vo("compare", recording, *options, "--output", output, "--json")
    assert (done.code, done.error_lines) == (0, "")
    content = json.loads(done.out)
    assert [(each["every"], each["frames"]) for each in content["sequences"]] == [(1, 10), (3, 4)]
    figures = content["sequences"][0]["methods"][method]
    assert 0 < figures["ate_rmse_m"] < 0.02
    assert (figures["coverage"], figures["gross_errors"], figures["steps"]) == (1.0, 0, 9)
    assert figures["ratios"]["ate_rmse_m"] == 1.0
    assert content["versions"]["opencv-python-headless"].startswith("5")
    rows = list(csv.DictReader((output / "metrics.csv").read_text().splitlines()))
    assert [row["every"] for row in rows] == ["1", "3"]
    assert read_toml(output / "config.toml", Config) == Config()


@pytest.mark.usefixtures("no_figures")
def test_the_terminal_shows_two_tables_per_sequence_and_a_note_of_skipped_methods(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo, have_methods: HaveMethods,
    monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    package = BaselinePackage("nobodys_odometry", ("nobodys-odometry",))
    monkeypatch.setitem(BASELINES, "open3d-icp", package)
    have_methods(surf="go on", icp="segfault")
    options = ("--methods", "surf", "icp", "open3d-icp", "--output", tmp_path / "out")
    done = kinect_vo("compare", recording, *options)
    assert (done.code, done.error_lines) == (
        1,
        "kinect-vo: error: corner, icp (run 2 of 2): crashed (signal 11, Segmentation fault)\n",
    )
    title, head, surf, icp, _, cost, *_, note, last = done.out.splitlines()
    assert title == f"corner, every frame: {FRAMES} frames in 0.4 s"
    assert head.split()[0] == cost.split()[0] == "method"
    assert surf.split()[0] == "surf"
    assert icp.startswith("icp: crashed")
    assert note == "not available: open3d-icp; run: pip install nobodys-odometry"
    assert last == f"report: {tmp_path / 'out' / 'report.html'}"


def test_all_methods_are_those_of_other_packages_too(
    recording: Path, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(names: object, *_: object) -> None:
        raise InputError(f"asked for {names}")

    monkeypatch.setattr(compare, "make_method_factories", refuse)
    done = kinect_vo("compare", recording, "--methods", "all")
    assert f"asked for {METHOD_NAMES}" in done.err
    done = kinect_vo("compare", recording)
    assert f"asked for {tuple(METHODS)}" in done.err


@pytest.mark.usefixtures("no_figures")
def test_with_loop_closure_each_method_has_additional_figures(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo, have_methods: HaveMethods
) -> None:
    have_methods(surf="go on", icp="segfault")
    options = ("--methods", "surf", "icp", "--loop-closure", "--output", tmp_path / "out")
    content = json.loads(kinect_vo("compare", recording, *options, "--json").out)
    methods = content["sequences"][0]["methods"]
    assert content["loop_closure"]["keyframe_database_mb"] == 100
    assert (methods["surf"]["map_keyframes"], methods["surf"]["loop_closures"]) == (1, 0)
    assert methods["surf"]["optimized_ate_rmse_m"] == pytest.approx(methods["surf"]["ate_rmse_m"])
    assert methods["surf"]["loop_closure_ms_per_frame"] > 0
    assert methods["icp"]["loop_closures"] is None
    optimized = tmp_path / "out" / "runs" / "corner" / "surf" / "trajectory_optimized.txt"
    assert len(optimized.read_text().splitlines()) == FRAMES


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["corner", "corner"], "names are equal; rename one folder"),
        (["corner", "--output", "file/out"], "file/out: cannot be written: Not a directory"),
        (["corner", "--methods", "surf", "--against", "orb"], "--against orb: it is not among"),
    ],
)
def test_invalid_input_is_one_line_before_any_run(
    copy_recording: CopyRecording,
    tmp_path: Path,
    kinect_vo: KinectVo,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    copy_recording()
    (tmp_path / "file").touch()
    monkeypatch.chdir(tmp_path)
    assert_one_line(kinect_vo("compare", *arguments), 2, message)
    assert {path.name for path in tmp_path.iterdir()} <= {"cache", "corner", "file"}


def test_a_scale_from_the_truth_needs_a_truth(
    copy_recording: CopyRecording, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = copy_recording()
    (folder / "groundtruth.txt").unlink()
    options = ("--methods", "sfm", "--sfm-scale", "ground-truth", "--output", tmp_path / "out")
    message = f"{folder}: has no groundtruth.txt, which --sfm-scale ground-truth needs"
    assert_one_line(kinect_vo("compare", folder, *options), 2, message)


@pytest.mark.usefixtures("no_figures")
def test_ctrl_c_leaves_a_report_of_finished_runs(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo, have_methods: HaveMethods
) -> None:
    have_methods(surf="go on", icp="hang")
    runs = tmp_path / "out" / "runs" / "corner"

    def interrupt() -> None:
        wait_until((runs / "surf" / "result.json").exists)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    done = kinect_vo("compare", recording, "--output", tmp_path / "out", "--json")
    assert (done.code, done.error_lines) == (130, "")
    methods = json.loads(done.out)["sequences"][0]["methods"]
    assert (methods["surf"]["state"], methods["icp"]["state"]) == ("done", "not run")
    assert not (runs / "icp").exists()
    assert (tmp_path / "out" / "report.html").exists()


# The source may be edited while the tests run, and what is kept is kept for one source.
SCRIPT = """
import sys
from tests.vo_service.tools.compare.faulty_methods import make_faulty_factories
from vo_service.cli import command_line
from vo_service.cli import compare
from vo_service.tools.compare import batch
compare.make_method_factories = make_faulty_factories(surf="go on", icp=sys.argv[1])
batch.collect_versions = dict
command_line.main(["compare", *sys.argv[2:]])
"""


def test_a_killed_comparison_leaves_no_process_and_resumes(
    copy_recording: CopyRecording, tmp_path: Path, kinect_vo: KinectVo, have_methods: HaveMethods,
    monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    recording = copy_recording()
    (recording / "groundtruth.txt").unlink()
    result = tmp_path / "out" / "runs" / "corner" / "surf" / "result.json"
    options = [str(recording), "--output", str(tmp_path / "out")]
    command = [sys.executable, "-c", SCRIPT, "hang", *options]
    with ForkedProcess(command) as process:
        wait_until(result.exists)
        wait_until(lambda: any(CHILD in command_line_of(c) for c in child_pids_of(process.pid)))
        child = find_child_running(process.pid, CHILD)
        process.kill()
        process.wait()
        wait_until(lambda: not is_alive(child))
    kept = result.stat().st_mtime_ns
    have_methods(surf="go on", icp="go on")
    monkeypatch.setattr(batch, "collect_versions", dict)
    assert kinect_vo("compare", *options).code == 0
    assert result.stat().st_mtime_ns == kept
    assert (result.parents[1] / "icp" / "result.json").exists()
