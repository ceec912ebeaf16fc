"""The tables of the bench, from made-up runs whose figures are known."""

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
from vo_service.tools.benchmark.frame_selection import FrameSelection
from vo_service.tools.benchmark.report.bench_metrics import (
    ALL_METRICS,
    RATIO_METRICS,
    metric_ratios,
    metric_values,
)
from vo_service.tools.benchmark.report.bench_tables import RelativeResults, bench_table

WALK = make_recording("walk")
RANKING = RelativeResults(
    make_results(
        WALK,
        surf=make_outcome(WALK, step_m=STEP_M + 0.001),
        icp=make_outcome(WALK, step_m=STEP_M + 0.002, lost=range(36, FRAMES)),
        sfm=CRASH,
    ),
    "surf",
)


def test_every_figure_of_a_run_has_a_key_and_those_of_a_crash_are_unknown() -> None:
    surf, crashed = (metric_values(RANKING.results.evaluations[name]) for name in ("surf", "sfm"))
    assert list(surf) == [metric.key for metric in ALL_METRICS]
    assert (surf["cpu_ms_mean"], surf["cpu_ms_p99"], surf["wall_ms_median"]) == (8.0, 8.0, 10.0)
    assert (surf["gross_errors"], surf["steps"]) == (0, FRAMES - 1)
    assert set(crashed.values()) == {None}


def test_ratios_are_to_the_method_that_is_named() -> None:
    judged = RANKING.results.evaluations
    found = metric_ratios(judged["icp"], judged["surf"])
    assert found["rpe_frame_m"] == pytest.approx(2.0)
    assert found["cpu_ms_mean"] == 1.0
    assert found["rpe_frame_deg"] is None  # of an error of zero there is no share
    assert set(metric_ratios(judged["icp"], judged["sfm"]).values()) == {None}


def test_for_people_there_is_a_row_a_method_and_ratios_beside_the_figures() -> None:
    title, head, surf, icp, sfm = RANKING.error_table().as_text().splitlines()
    assert title == "walk, every frame: 40 frames in 1.3 s; in () times that of surf"
    assert head.split()[:3] == ["method", "ATE", "mm"]
    assert "19.50 (1.00)" in surf
    assert "35.00 (1.79)" in icp
    assert icp.split()[-5:] == ["90.0", "4", "0", "0", "35"]
    assert sfm.split()[:3] == ["sfm:", "crashed", "-"]
    assert RANKING.cost_table().as_text().splitlines()[2].split()[:3] == ["surf", "8.0", "(1.00)"]


def test_the_title_says_which_frames_and_whether_there_is_a_truth() -> None:
    bare = make_recording("bare", has_truth=False).select(FrameSelection(step=5))
    title = RelativeResults(make_results(bare, surf=CRASH), "surf").title
    assert title == (
        "bare, 1 frame in 5: 8 frames in 1.2 s, no groundtruth.txt: errors are not known"
    )


def test_for_scripts_there_is_one_table_with_every_figure_and_ratio() -> None:
    tenth = WALK.select(FrameSelection(step=10))
    slow = RelativeResults(make_results(tenth, surf=CRASH), "surf")
    rows = list(csv.DictReader(io.StringIO(bench_table([RANKING, slow]).as_csv())))
    assert [(row["sequence"], row["every"], row["frames"]) for row in rows] == [
        *[("walk", "1", "40")] * 3,
        ("walk", "10", "4"),
    ]
    assert float(rows[1]["rpe_frame_m"]) == pytest.approx(0.002)
    assert float(rows[1]["mean_global_error_m_ratio"]) == pytest.approx(35.0 / 19.5)
    assert rows[2]["state"] == "crashed"
    assert all(rows[2][f"{metric.key}_ratio"] == "" for metric in RATIO_METRICS)


def test_with_loops_there_are_columns_more_and_no_other_changes() -> None:
    drifting = make_outcome(WALK, step_m=STEP_M + 0.001, with_loops=make_loop_closure_run(WALK))
    plain = RelativeResults(make_results(WALK, surf=drifting), "surf")
    told = RelativeResults(make_results(WALK, has_loops=True, surf=drifting), "surf")
    (*title, _, surf), (*_, cost) = (
        table.as_text().splitlines() for table in (told.error_table(), told.cost_table())
    )
    assert title == [plain.title + "; in () times that of surf"]
    assert surf.split()[-4:] == ["0.00", "0.00", "3", "2"]
    assert cost.split()[-1] == "1.50"
    (row,), (before,) = (
        csv.DictReader(io.StringIO(bench_table([each]).as_csv())) for each in (told, plain)
    )
    new = [
        "optimized_ate_rmse_m",
        "optimized_mean_global_error_m",
        "map_keyframes",
        "loop_closures",
    ]
    assert set(row) - set(before) == {*new, "loop_closure_ms_per_frame"}
    assert row.items() > before.items()
