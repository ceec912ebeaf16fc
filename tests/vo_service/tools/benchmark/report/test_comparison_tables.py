"""The tables for people and scripts, with the paper's results."""

import csv
import io
from pathlib import Path

import pytest

from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.benchmark.report.comparison_tables import (
    PUBLISHED_RESULTS,
    describe_method,
    error_table,
    find_published_results,
    gap_table,
    loop_closure_table,
    metrics_table,
    time_table,
)
from vo_service.tools.benchmark.results import SequenceResults

FLOOR = "rgbd_dataset_freiburg1_floor"


@pytest.fixture
def floor() -> SequenceResults:
    """Sequence of the paper with a gap: surf is exact, icp drifts, sfm has crashed."""
    recording = make_recording(FLOOR, gap_s=1.0)
    return make_results(
        recording,
        surf=make_outcome(recording, lost=range(20, 22)),
        icp=make_outcome(recording, step_m=0.02),
        sfm=CRASH,
    )


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_table_one_has_the_papers_errors_beside_ours(floor: SequenceResults) -> None:
    (row,) = rows(error_table([floor]).as_csv())
    assert row["sequence"] == FLOOR
    assert float(row["surf_mean_global_error_m"]) == pytest.approx(0.0, abs=1e-9)
    assert float(row["icp_mean_global_error_m"]) == pytest.approx(0.195)
    assert row["sfm_mean_global_error_m"] == ""
    assert [row[f"paper_{m}"] for m in ("surf", "icp", "sfm")] == ["0.05", "0.12", "0.51"]


def test_table_two_has_both_times_and_the_papers(floor: SequenceResults) -> None:
    (row,) = rows(time_table([floor]).as_csv())
    assert float(row["surf_cpu_s"]) == pytest.approx(0.32)
    assert float(row["surf_wall_s"]) == pytest.approx(0.4)
    assert (row["sfm_cpu_s"], row["paper_sfm"], row["paper_surf"]) == ("", "950", "458")


def test_in_text_the_best_has_a_star_and_a_crash_its_state(floor: SequenceResults) -> None:
    title, head, row = error_table([floor]).as_text().splitlines()
    assert title == "Table I: mean global error, in millimeters"
    assert head.split("  ")[0] == "sequence"
    assert row.split() == [FLOOR, "0.00", "(95", "%)*", "195.00", "crashed", "50", "120", "510"]


def test_a_method_with_low_coverage_is_never_the_best() -> None:
    recording = make_recording()
    few, all_frames = (
        make_outcome(recording, lost=range(10, 40)),
        make_outcome(recording, step_m=0.02),
    )
    (row,) = error_table([make_results(recording, surf=few, icp=all_frames, sfm=all_frames)]).rows
    assert [cell.is_best for cell in row] == [False, False, True, False]
    assert row[1].text == "0.00 (25 %)"


def test_errors_below_a_millimeter_are_visible_and_in_meters_for_scripts() -> None:
    recording = make_recording()
    table = error_table(
        [
            make_results(
                recording,
                surf=make_outcome(recording, step_m=0.01002),
                icp=make_outcome(recording, step_m=0.01004),
            )
        ]
    )
    assert [cell.text for cell in table.rows[0][1:]] == ["0.39", "0.78"]
    (row,) = rows(table.as_csv())
    assert float(row["surf_mean_global_error_m"]) == pytest.approx(0.00039)


def test_other_sequences_have_no_paper_columns() -> None:
    recording = make_recording("kitchen")
    table = error_table([make_results(recording, surf=make_outcome(recording))])
    assert table.keys == ["sequence", "surf_mean_global_error_m"]
    assert not table.rows[0][1].is_best  # a single method is not the best


def test_every_run_is_a_row_of_all_metrics(floor: SequenceResults) -> None:
    metrics = rows(metrics_table([floor]).as_csv())
    assert [row["method"] for row in metrics] == ["surf", "icp", "sfm"]
    assert [row["state"] for row in metrics] == ["done", "done", "crashed"]
    assert metrics[2]["error"] == CRASH.error
    assert (metrics[0]["coverage"], metrics[0]["failed"], metrics[2]["coverage"]) == (
        "0.95",
        "2",
        "",
    )


def test_every_gap_is_a_row_for_every_run_with_a_result(floor: SequenceResults) -> None:
    surf, icp = rows(gap_table([floor]).as_csv())
    assert float(surf["length_s"]) == pytest.approx(1 + 1 / 30, abs=1e-5)
    assert (surf["method"], surf["across"]) == ("surf", "lost 2 frames, then recovered")
    assert (icp["across"], round(float(icp["error_m"]), 6)) == ("kept tracking", 0.01)


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
    assert bool(find_published_results(Path("/data") / folder)) == known


def test_the_published_results_are_correct() -> None:
    errors = {
        name: [PUBLISHED_RESULTS[name][m].mean_global_error_m for m in PUBLISHED_RESULTS[name]]
        for name in PUBLISHED_RESULTS
    }
    times = {
        name: [PUBLISHED_RESULTS[name][m].time_s for m in PUBLISHED_RESULTS[name]]
        for name in PUBLISHED_RESULTS
    }
    assert list(PUBLISHED_RESULTS["floor"]) == ["surf", "icp", "sfm"]
    assert errors == {"floor": [0.05, 0.12, 0.51], "teddy": [0.13, 0.74, 0.22]}
    assert times == {"floor": [458, 621, 950], "teddy": [953, 1155, 1430]}


def test_an_unknown_method_has_its_own_name() -> None:
    assert describe_method("orb").name == "ORB"


def test_the_effect_of_loop_closure_is_a_separate_table() -> None:
    walk = make_recording("walk")
    drifting = make_outcome(walk, step_m=0.02, loop_closure=make_loop_closure_run(walk))
    surf, icp = rows(
        loop_closure_table([make_results(walk, True, surf=drifting, icp=CRASH)]).as_csv()
    )
    assert float(surf["mean_global_error_m"]) == pytest.approx(0.195)
    assert float(surf["optimized_mean_global_error_m"]) == pytest.approx(0.0, abs=1e-9)
    assert float(surf["optimized_ate_rmse_m"]) == pytest.approx(0.0, abs=1e-9)
    assert [
        surf[key] for key in ("map_keyframes", "loop_closures", "loop_closure_ms_per_frame")
    ] == ["3", "2", "1.5"]
    assert (icp["state"], icp["loop_closures"]) == ("crashed", "")
