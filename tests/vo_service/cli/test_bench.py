"""``kinect-vo bench`` as it is typed."""

import csv
import json
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core.config import read_toml
from tests.conftest import FRAMES
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.tools.benchmark.faulty_methods import make_faulty_factories
from tests.waiting import wait_until
from vo_service.cli import bench
from vo_service.config import Config
from vo_service.tools.benchmark.baselines import BASELINES, Baseline, BaselinePackage

pytestmark = [pytest.mark.subprocess, pytest.mark.usefixtures("forked_runs")]

CopyRecording = Callable[..., Path]
Capture = pytest.CaptureFixture[str]


def test_a_baseline_is_measured_at_each_rate_and_reported(
    recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    output = tmp_path / "out"
    options = ("--methods", "cv2-rgb-depth", "--every", 1, 3, "--frames", 10, "--output", output)
    done = run_in_process(capfd, "bench", recording, *options, "--json")
    assert (done.code, done.error_lines) == (0, "")
    report = json.loads(done.out)
    assert report == json.loads((output / "report.json").read_text())
    assert [(r["every"], r["frames"]) for r in report["results"]] == [(1, 10), (3, 4)]
    figures = report["results"][0]["methods"]["cv2-rgb-depth"]
    assert 0 < figures["ate_rmse_m"] < 0.02
    assert (figures["coverage"], figures["gross_errors"], figures["steps"]) == (1.0, 0, 9)
    assert 0 < figures["cpu_ms_median"] <= figures["cpu_ms_p99"]
    assert figures["ratios"]["ate_rmse_m"] == 1.0
    assert report["versions"]["opencv-python-headless"].startswith("5")
    rows = list(csv.DictReader((output / "bench.csv").read_text().splitlines()))
    assert [row["every"] for row in rows] == ["1", "3"]
    assert read_toml(output / "config.toml", Config) == Config()


def test_the_terminal_shows_two_tables_per_sequence_and_a_note_of_skipped_methods(
    recording: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = Baseline(
        BaselinePackage("nobodys_odometry", ("nobodys-odometry",)), BASELINES["orb"].make
    )
    monkeypatch.setitem(BASELINES, "open3d-icp", missing)
    monkeypatch.setattr(
        bench, "make_method_factories", make_faulty_factories(surf="go on", icp="segfault")
    )
    done = run_in_process(capfd, "bench", recording, "--methods", "surf", "icp", "open3d-icp")
    assert (done.code, done.error_lines.count("\n")) == (1, 1)
    assert "corner, icp (run 2 of 2): crashed (signal 11" in done.err
    title, head, surf, icp, _, cost, *_, note = done.out.splitlines()
    assert title == f"corner, every frame: {FRAMES} frames in 0.4 s; in () relative to surf"
    assert head.split()[0] == cost.split()[0] == "method"
    assert surf.split()[0] == "surf"
    assert icp.startswith("icp: crashed")
    assert note == "not available: open3d-icp; run: pip install nobodys-odometry"


def test_without_truth_cost_and_coverage_are_reported(
    copy_recording: CopyRecording, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "make_method_factories", make_faulty_factories(surf="lose it"))
    folder = copy_recording()
    (folder / "groundtruth.txt").unlink()
    done = run_in_process(capfd, "bench", folder, "--methods", "surf", "--json")
    figures = json.loads(done.out)["results"][0]["methods"]["surf"]
    assert (figures["coverage"], figures["failed"], figures["ate_rmse_m"]) == (0.25, 9, None)
    assert figures["gross_errors"] is None
    assert figures["cpu_ms_mean"] > 0
    assert figures["memory_mb"] > 10


def test_with_loop_closure_each_method_has_additional_figures(
    recording: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        bench, "make_method_factories", make_faulty_factories(surf="go on", icp="segfault")
    )
    done = run_in_process(
        capfd, "bench", recording, "--methods", "surf", "icp", "--loop-closure", "--json"
    )
    report = json.loads(done.out)
    methods = report["results"][0]["methods"]
    assert report["loop_closure"]["keyframe_database_mb"] == 100
    assert (methods["surf"]["map_keyframes"], methods["surf"]["loop_closures"]) == (1, 0)
    assert methods["surf"]["optimized_ate_rmse_m"] == pytest.approx(methods["surf"]["ate_rmse_m"])
    assert methods["surf"]["loop_closure_ms_per_frame"] > 0
    assert methods["icp"]["loop_closures"] is None


def test_with_an_output_folder_it_resumes(
    copy_recording: CopyRecording, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = (copy_recording(), "--output", tmp_path / "out", "--json")
    runs = tmp_path / "out" / "runs" / "corner"

    def interrupt() -> None:
        wait_until((runs / "surf" / "result.json").exists)
        os.kill(os.getpid(), signal.SIGINT)

    # The source may be edited while the tests run, and what is kept is kept for one source.
    monkeypatch.setattr("vo_service.tools.benchmark.batch.collect_versions", dict)
    monkeypatch.setattr(
        bench, "make_method_factories", make_faulty_factories(surf="go on", icp="hang")
    )
    threading.Thread(target=interrupt).start()
    stopped = run_in_process(capfd, "bench", *options)
    assert (stopped.code, stopped.error_lines) == (130, "")
    methods = json.loads(stopped.out)["results"][0]["methods"]
    assert (methods["surf"]["state"], methods["icp"]["state"]) == ("done", "not run")
    kept = (runs / "surf" / "result.json").stat().st_mtime_ns
    monkeypatch.setattr(
        bench, "make_method_factories", make_faulty_factories(surf="go on", icp="go on")
    )
    assert run_in_process(capfd, "bench", *options).code == 0
    assert (runs / "surf" / "result.json").stat().st_mtime_ns == kept
    assert (runs / "icp" / "result.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone"], "gone: no such folder; check the path"),
        (["corner", "corner"], "names are equal; rename one folder"),
        (["corner", "--methods", "magic"], "invalid choice: 'magic'"),
        (["corner", "--every", "0"], "0 is not a count: give a whole number, 1 or more"),
        (["corner", "--every", "1", "x"], "x is not a count"),
        (["corner", "--frames", "-3"], "-3 is not a count"),
        (["corner", "--methods", "surf", "--against", "orb"], "--against orb: it is not among"),
        (["corner", "--output", "file/out"], "name another with --output"),
    ],
)
def test_invalid_input_is_one_line_before_any_run(
    copy_recording: CopyRecording,
    tmp_path: Path,
    capfd: Capture,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    copy_recording()
    (tmp_path / "file").touch()
    monkeypatch.chdir(tmp_path)
    done = run_in_process(capfd, "bench", *arguments)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert message in done.err
    assert {path.name for path in tmp_path.iterdir()} <= {"cache", "corner", "file"}
