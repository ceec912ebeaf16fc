"""``kinect-vo compare`` as it is typed."""

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import FRAMES
from tests.forked_process import ForkedProcess
from tests.resource_leaks import child_pids_of, command_line_of, find_child_running, is_alive
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.tools.benchmark.faulty_methods import make_faulty_factories
from tests.waiting import wait_until
from vo_service.cli import compare
from vo_service.tools.benchmark import batch
from vo_service.tools.benchmark.report import comparison_report

pytestmark = [pytest.mark.subprocess, pytest.mark.usefixtures("forked_runs")]

CopyRecording = Callable[..., Path]
Capture = pytest.CaptureFixture[str]
CHILD = "vo_service.tools.benchmark.worker_main:run_benchmark"


def test_a_comparison_gives_a_report_and_the_poses_of_a_replay(
    recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    output = tmp_path / "report"
    done = run_in_process(
        capfd, "compare", recording, "--methods", "surf", "--output", output, "--json"
    )
    assert (done.code, done.error_lines) == (0, "")
    assert json.loads(done.out) == json.loads((output / "report.json").read_text())
    surf = json.loads(done.out)["sequences"][0]["methods"]["surf"]
    assert (surf["state"], surf["frames"], surf["failed"], surf["coverage"]) == (
        "done",
        FRAMES,
        0,
        1.0,
    )
    assert 0 < surf["mean_global_error_m"] < 0.003
    assert surf["cpu_ms_per_frame"] > 0
    assert (output / "report.html").stat().st_size > 10_000
    replayed = tmp_path / "replayed.txt"
    run_in_process(
        capfd, "replay", recording, "--method", "surf", "--no-publish", "--trajectory", replayed
    )
    kept = output / "runs" / recording.name / "surf" / "trajectory.txt"
    assert kept.read_bytes() == replayed.read_bytes()


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take most of the time of a report, and have tests of their own."""
    monkeypatch.setattr(comparison_report, "_make_figures", lambda result: iter(()))


@pytest.mark.usefixtures("no_figures")
def test_the_terminal_shows_two_tables_and_a_crash_is_a_row_and_an_exit_code(
    recording: Path, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "make_method_factories", make_faulty_factories(surf="segfault"))
    done = run_in_process(
        capfd, "compare", recording, "--methods", "surf", "--output", tmp_path / "out"
    )
    assert (done.code, done.err) == (
        1,
        "kinect-vo: error: corner, surf (run 1 of 1): crashed (signal 11, Segmentation fault)\n",
    )
    title, _, row, _, second, *_, last = done.out.splitlines()
    assert title == "Table I: mean global error, in millimeters"
    assert row.split() == ["corner", "crashed"]
    assert second == "Table II: processing time of the whole recording, in seconds"
    assert last == f"report: {tmp_path / 'out' / 'report.html'}"


@pytest.mark.usefixtures("no_figures")
def test_with_loop_closure_there_is_a_table_of_the_gain(
    recording: Path, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "make_method_factories", make_faulty_factories(surf="go on"))
    options = ("--methods", "surf", "--loop-closure", "--output", tmp_path / "out")
    done = run_in_process(capfd, "compare", recording, *options)
    assert (done.code, done.error_lines) == (0, "")
    *_, title, head, row, _, _ = done.out.splitlines()
    assert title == "Loop closure"
    assert "optimized ATE mm" in head
    _, _, _, ate, corrected_ate, *_, places, loops, _, state = row.split()
    assert (corrected_ate, places, loops, state) == (ate, "1", "0", "done")
    assert (tmp_path / "out" / "loop_closures.csv").exists()
    corrected = tmp_path / "out" / "runs" / "corner" / "surf" / "trajectory_optimized.txt"
    assert len(corrected.read_text().splitlines()) == FRAMES


@pytest.mark.usefixtures("no_figures")
def test_without_truth_coverage_and_times_are_reported(
    copy_recording: CopyRecording, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "make_method_factories", make_faulty_factories(surf="lose it"))
    folder = copy_recording()
    (folder / "groundtruth.txt").unlink()
    options = ("--methods", "surf", "--output", tmp_path / "out", "--json")
    done = run_in_process(capfd, "compare", folder, *options)
    assert (done.code, done.error_lines) == (0, "")
    surf = json.loads(done.out)["sequences"][0]["methods"]["surf"]
    assert (surf["coverage"], surf["ate_rmse_m"]) == (0.25, None)
    assert surf["no_evaluation"] == "there is no groundtruth.txt"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone"], "gone: no such folder; check the path"),
        (["corner", "empty"], "empty: the folder is empty; name one with rgb.txt and depth.txt"),
        (["corner", "corner"], "names are equal; rename one folder"),
        (["corner", "--output", "file/out"], "name another with --output"),
        (["corner", "--methods", "magic"], "invalid choice: 'magic'"),
        (["corner", "--time-limit", "0"], "0 is not a duration: give seconds, more than 0"),
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
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    monkeypatch.chdir(tmp_path)
    done = run_in_process(capfd, "compare", *arguments)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert message in done.err
    assert {path.name for path in tmp_path.iterdir()} <= {"cache", "corner", "empty", "file"}


def test_a_scale_from_the_truth_needs_a_truth(
    copy_recording: CopyRecording, tmp_path: Path, capfd: Capture
) -> None:
    folder = copy_recording()
    (folder / "groundtruth.txt").unlink()
    options = ("--methods", "sfm", "--sfm-scale", "ground-truth", "--output", tmp_path / "out")
    done = run_in_process(capfd, "compare", folder, *options)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert f"{folder}: has no groundtruth.txt, which --sfm-scale ground-truth needs" in done.err


@pytest.mark.usefixtures("no_figures")
def test_ctrl_c_leaves_a_report_of_finished_runs(
    recording: Path, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        compare, "make_method_factories", make_faulty_factories(surf="go on", icp="hang")
    )
    runs = tmp_path / "out" / "runs" / "corner"

    def interrupt() -> None:
        wait_until((runs / "surf" / "result.json").exists)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    done = run_in_process(capfd, "compare", recording, "--output", tmp_path / "out", "--json")
    assert (done.code, done.error_lines) == (130, "")
    methods = json.loads(done.out)["sequences"][0]["methods"]
    assert (methods["surf"]["state"], methods["icp"]["state"]) == ("done", "not run")
    assert not (runs / "icp").exists()
    assert (tmp_path / "out" / "report.html").exists()


# The source may be edited while the tests run, and what is kept is kept for one source.
SCRIPT = """
import sys
from tests.vo_service.tools.benchmark.faulty_methods import make_faulty_factories
from vo_service import cli
from vo_service.cli import compare
from vo_service.tools.benchmark import batch
from vo_service.tools.benchmark.report import comparison_report
compare.make_method_factories = make_faulty_factories(surf="go on", icp=sys.argv[1])
batch.collect_versions = dict
cli.main(["compare", *sys.argv[2:]])
"""


def test_a_killed_comparison_leaves_no_process_and_resumes(
    copy_recording: CopyRecording, tmp_path: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    monkeypatch.setattr(
        compare, "make_method_factories", make_faulty_factories(surf="go on", icp="go on")
    )
    monkeypatch.setattr(batch, "collect_versions", dict)
    assert run_in_process(capfd, "compare", *options).code == 0
    assert result.stat().st_mtime_ns == kept
    assert (result.parents[1] / "icp" / "result.json").exists()
