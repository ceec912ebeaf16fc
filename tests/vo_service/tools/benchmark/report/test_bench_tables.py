"""The tables of the bench, from simulated runs with known metrics."""

import csv
import io

import pytest

from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    FRAMES,
    STEP_M,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.benchmark.recordings import FrameSelection
from vo_service.tools.benchmark.report.bench_report import (
    ALL_METRICS,
    RATIO_METRICS,
    RelativeResults,
    bench_table,
    metric_ratios,
    metric_values,
)

WALK = make_recording("walk")
RESULTS = RelativeResults(
    make_results(
        WALK,
        surf=make_outcome(WALK, step_m=STEP_M + 0.001),
        icp=make_outcome(WALK, step_m=STEP_M + 0.002, lost=range(36, FRAMES)),
        sfm=CRASH,
    ),
    "surf",
)


def test_every_metric_of_a_run_has_a_key_and_those_of_a_crash_are_none() -> None:
    surf, crashed = (metric_values(RESULTS.results.evaluations[name]) for name in ("surf", "sfm"))
    assert list(surf) == [metric.key for metric in ALL_METRICS]
    assert (surf["cpu_ms_mean"], surf["cpu_ms_p99"], surf["wall_ms_median"]) == (8.0, 8.0, 10.0)
    assert (surf["gross_errors"], surf["steps"]) == (0, FRAMES - 1)
    assert set(crashed.values()) == {None}


def test_ratios_are_relative_to_the_named_method() -> None:
    evaluations = RESULTS.results.evaluations
    ratios = metric_ratios(evaluations["icp"], evaluations["surf"])
    assert ratios["rpe_frame_m"] == pytest.approx(2.0)
    assert ratios["cpu_ms_mean"] == 1.0
    assert ratios["rpe_frame_deg"] is None  # there is no ratio to an error of zero
    assert set(metric_ratios(evaluations["icp"], evaluations["sfm"]).values()) == {None}


def test_the_text_table_has_one_row_per_method_and_ratios_beside_the_metrics() -> None:
    title, head, surf, icp, sfm = RESULTS.error_table().as_text().splitlines()
    assert title == "walk, every frame: 40 frames in 1.3 s; in () relative to surf"
    assert head.split()[:3] == ["method", "ATE", "mm"]
    assert "19.50 (1.00)" in surf
    assert "35.00 (1.79)" in icp
    assert icp.split()[-5:] == ["90.0", "4", "0", "0", "35"]
    assert sfm.split()[:3] == ["sfm:", "crashed", "-"]
    assert RESULTS.cost_table().as_text().splitlines()[2].split()[:3] == ["surf", "8.0", "(1.00)"]


def test_the_title_names_the_frames_and_a_missing_truth() -> None:
    recording = make_recording("bare", has_truth=False).select(FrameSelection(step=5))
    title = RelativeResults(make_results(recording, surf=CRASH), "surf").title
    assert title == (
        "bare, 1 frame in 5: 8 frames in 1.2 s, no groundtruth.txt, so errors are not known"
    )


def test_the_table_for_scripts_has_every_metric_and_ratio() -> None:
    tenth = WALK.select(FrameSelection(step=10))
    slow = RelativeResults(make_results(tenth, surf=CRASH), "surf")
    rows = list(csv.DictReader(io.StringIO(bench_table([RESULTS, slow]).as_csv())))
    assert [(row["sequence"], row["every"], row["frames"]) for row in rows] == [
        *[("walk", "1", "40")] * 3,
        ("walk", "10", "4"),
    ]
    assert float(rows[1]["rpe_frame_m"]) == pytest.approx(0.002)
    assert float(rows[1]["mean_global_error_m_ratio"]) == pytest.approx(35.0 / 19.5)
    assert rows[2]["state"] == "crashed"
    assert all(rows[2][f"{metric.key}_ratio"] == "" for metric in RATIO_METRICS)


def test_loop_closure_adds_columns_and_changes_no_others() -> None:
    drifting = make_outcome(WALK, step_m=STEP_M + 0.001, loop_closure=make_loop_closure_run(WALK))
    plain = RelativeResults(make_results(WALK, surf=drifting), "surf")
    with_loop_closure = RelativeResults(
        make_results(WALK, has_loop_closure=True, surf=drifting), "surf"
    )
    (*title, _, surf), (*_, cost) = (
        table.as_text().splitlines()
        for table in (with_loop_closure.error_table(), with_loop_closure.cost_table())
    )
    assert title == [plain.title + "; in () relative to surf"]
    assert surf.split()[-4:] == ["0.00", "0.00", "3", "2"]
    assert cost.split()[-1] == "1.50"
    (row,), (before,) = (
        csv.DictReader(io.StringIO(bench_table([results]).as_csv()))
        for results in (with_loop_closure, plain)
    )
    added = [
        "optimized_ate_rmse_m",
        "optimized_mean_global_error_m",
        "map_keyframes",
        "loop_closures",
    ]
    assert set(row) - set(before) == {*added, "loop_closure_ms_per_frame"}
    assert row.items() > before.items()
