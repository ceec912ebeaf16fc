"""The tables for people and scripts, from simulated runs with known metrics."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest

from tests.vo_service.tools.compare.sample_runs import (
    CRASH,
    FRAMES,
    STEP_M,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.compare.recordings import FrameSelection
from vo_service.tools.compare.report.metrics import METRICS, RATIO_METRICS, metrics_as_json
from vo_service.tools.compare.report.tables import (
    Table,
    cost_table,
    error_table,
    find_published_results,
    gap_table,
    metrics_table,
    paper_table,
)

FLOOR = "rgbd_dataset_freiburg1_floor"
WALK = make_recording("walk")
PLAIN = make_results(
    WALK,
    surf=make_outcome(WALK, step_m=STEP_M + 0.001),
    icp=make_outcome(WALK, step_m=STEP_M + 0.002, lost=range(36, FRAMES)),
    sfm=CRASH,
)
RELATIVE = replace(PLAIN, reference_method="surf")


def lines(table: Table) -> list[str]:
    stream = io.StringIO()
    table.write(stream)
    return stream.getvalue().splitlines()


def rows(table: Table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(table.as_csv())))


def test_every_metric_of_a_run_has_a_key_and_those_of_a_crash_are_none() -> None:
    surf, crashed = (metrics_as_json(PLAIN, name) for name in ("surf", "sfm"))
    assert list(surf) == [*(metric.key for metric in METRICS), "ratios"]
    assert (surf["cpu_ms_mean"], surf["cpu_ms_p99"], surf["wall_ms_median"]) == (8.0, 8.0, 10.0)
    assert (surf["gross_errors"], surf["steps"]) == (0, FRAMES - 1)
    assert {crashed[metric.key] for metric in METRICS} == {None}
    assert surf["ratios"] == {}


def test_ratios_are_relative_to_the_named_method() -> None:
    ratios = metrics_as_json(RELATIVE, "icp")["ratios"]
    assert isinstance(ratios, dict)
    assert ratios["rpe_frame_m"] == pytest.approx(2.0)
    assert ratios["cpu_ms_mean"] == 1.0
    assert ratios["rpe_frame_deg"] is None  # there is no ratio to an error of zero
    to_crash = metrics_as_json(replace(PLAIN, reference_method="sfm"), "icp")["ratios"]
    assert to_crash == dict.fromkeys(metric.key for metric in RATIO_METRICS)


def test_the_text_tables_have_one_row_per_method() -> None:
    title, head, surf, icp, sfm = lines(error_table(PLAIN))
    assert title == "walk, every frame: 40 frames in 1.3 s"
    assert head.split()[:5] == ["method", "ATE", "mm", "global", "mm"]
    assert surf.split()[:3] == ["surf", "11.54", "19.50"]
    assert icp.split()[-5:] == ["90.0", "4", "0", "0", "35"]
    assert sfm.split()[:3] == ["sfm:", "crashed", "-"]
    assert lines(cost_table(PLAIN))[2].split()[:3] == ["surf", "8.0", "8.0"]


def test_ratios_are_beside_the_metrics_if_wanted() -> None:
    title, _, surf, icp, _ = lines(error_table(RELATIVE))
    assert title == "walk, every frame: 40 frames in 1.3 s; in () relative to surf"
    assert "19.50 (1.00)" in surf
    assert "35.00 (1.79)" in icp
    assert lines(cost_table(RELATIVE))[2].split()[:3] == ["surf", "8.0", "(1.00)"]


def test_the_title_names_the_step_and_a_missing_truth() -> None:
    recording = make_recording("bare", has_truth=False).select(FrameSelection(step=5))
    assert error_table(make_results(recording, surf=CRASH)).title == (
        "bare, 1 frame in 5: 8 frames in 1.2 s, no groundtruth.txt, so errors are not known"
    )


def test_the_smallest_error_is_the_best_unless_its_coverage_is_low() -> None:
    few, exact = make_outcome(WALK, lost=range(10, 40)), make_outcome(WALK, step_m=0.02)
    table = error_table(make_results(WALK, surf=few, icp=exact, sfm=exact))
    assert [row[1].is_best for row in table.rows] == [False, True, False]
    single = error_table(make_results(WALK, surf=exact))
    assert not single.rows[0][1].is_best


def test_the_table_for_scripts_has_every_metric_and_ratio() -> None:
    tenth = WALK.select(FrameSelection(step=10))
    slow = replace(make_results(tenth, surf=CRASH), reference_method="surf")
    found = rows(metrics_table([RELATIVE, slow]))
    assert [(row["sequence"], row["every"], row["frames"]) for row in found] == [
        *[("walk", "1", "40")] * 3,
        ("walk", "10", "4"),
    ]
    assert float(found[1]["rpe_frame_m"]) == pytest.approx(0.002)
    assert float(found[1]["mean_global_error_m_ratio"]) == pytest.approx(35.0 / 19.5)
    assert (float(found[0]["cpu_s"]), float(found[0]["wall_s"])) == pytest.approx((0.32, 0.4))
    assert (found[2]["state"], found[2]["error"]) == ("crashed", CRASH.error)
    assert all(found[2][f"{metric.key}_ratio"] == "" for metric in RATIO_METRICS)
    assert not any(key.endswith("_ratio") for key in rows(metrics_table([PLAIN]))[0])


def test_loop_closure_adds_columns_and_changes_no_others() -> None:
    outcome = make_outcome(WALK, step_m=STEP_M + 0.001, loop_closure=make_loop_closure_run(WALK))
    plain = make_results(WALK, surf=outcome)
    closed = make_results(WALK, has_loop_closure=True, surf=outcome, icp=CRASH)
    assert lines(error_table(closed))[2].split()[-4:] == ["0.00", "0.00", "3", "2"]
    assert lines(cost_table(closed))[2].split()[-1] == "1.50"
    (row, crashed), (before,) = rows(metrics_table([closed])), rows(metrics_table([plain]))
    assert set(row) - set(before) == {
        "optimized_ate_rmse_m",
        "optimized_mean_global_error_m",
        "map_keyframes",
        "loop_closures",
        "loop_closure_ms_per_frame",
    }
    assert row.items() > before.items()
    assert crashed["loop_closures"] == ""
    assert metrics_as_json(closed, "surf")["loop_closure_ms_per_frame"] == 1.5


def test_every_gap_is_a_row_for_every_run_with_a_result() -> None:
    recording = make_recording(gap_s=1.0)
    lost, drifting = (
        make_outcome(recording, lost=range(20, 22)),
        make_outcome(recording, step_m=0.02),
    )
    surf, icp = rows(gap_table([make_results(recording, surf=lost, icp=drifting, sfm=CRASH)]))
    assert float(surf["length_s"]) == pytest.approx(1 + 1 / 30, abs=1e-5)
    assert (surf["method"], surf["across"]) == ("surf", "lost 2 frames, then recovered")
    assert (icp["across"], round(float(icp["error_m"]), 6)) == ("kept tracking", 0.01)


def test_the_papers_results_are_beside_ours() -> None:
    floor = make_recording(FLOOR)
    results = make_results(floor, surf=make_outcome(floor), direct=make_outcome(floor), sfm=CRASH)
    surf, direct, sfm = rows(paper_table([PLAIN, results]))
    assert (surf["sequence"], surf["method"]) == (FLOOR, "surf")
    assert float(surf["mean_global_error_m"]) == pytest.approx(0.0, abs=1e-9)
    assert (surf["paper_mean_global_error_m"], surf["paper_time_s"]) == ("0.05", "458")
    assert direct["paper_time_s"] == ""
    assert (sfm["cpu_s"], sfm["paper_time_s"]) == ("", "950")
    assert paper_table([PLAIN]).rows == []


@pytest.mark.parametrize(
    ("folder", "known"),
    [
        (FLOOR, True),
        ("tum/fr1/teddy", True),
        ("freiburg1_teddy", True),
        ("freiburg1_floor_cut", False),
        ("rgbd_dataset_freiburg2_floor", False),
        ("floor", False),
    ],
)
def test_only_the_papers_complete_sequences_have_its_results(folder: str, known: bool) -> None:
    recording = replace(WALK, folder=Path("/data") / folder)
    assert bool(find_published_results(recording)) == known
    assert not find_published_results(recording.select(FrameSelection(step=2)))
