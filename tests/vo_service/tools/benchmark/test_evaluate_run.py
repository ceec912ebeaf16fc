"""The figures of made-up runs, whose errors are known."""

import pytest

from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    FRAMES,
    STEP_M,
    make_loop_closure_run,
    make_outcome,
    make_recording,
)
from vo_service.tools.benchmark.batch import BatchResult
from vo_service.tools.benchmark.evaluate_run import (
    EVALUATION_KEYS,
    LOOP_CLOSURE_KEYS,
    RunEvaluation,
    evaluate_run,
)
from vo_service.tools.benchmark.recordings import BenchmarkRecording


def judged(of: BenchmarkRecording, **how: object) -> RunEvaluation:
    return evaluate_run(BatchResult(of, "surf", make_outcome(of, **how)))


def test_a_run_is_judged_by_the_truth_of_its_recording() -> None:
    figures = judged(make_recording(), step_m=STEP_M + 0.001).as_json()
    assert figures["mean_global_error_m"] == pytest.approx(0.001 * (FRAMES - 1) / 2)
    assert figures["rpe_frame_m"] == pytest.approx(0.001)
    assert (figures["coverage"], figures["cpu_s"], figures["wall_s"]) == (1.0, 0.32, 0.4)
    assert (figures["state"], figures["gaps"], figures["no_evaluation"]) == ("done", [], "")


def test_steps_that_are_grossly_wrong_are_counted_but_not_into_a_new_epoch() -> None:
    assert judged(make_recording()).gross_errors == 0
    wild = judged(make_recording(), step_m=STEP_M + 0.06, lost=range(20, 24), epoch_from=24)
    assert (wild.gross_errors, wild.steps) == (FRAMES - 4 - 2, FRAMES - 4 - 2)
    assert wild.as_json()["gross_errors"] == wild.gross_errors


def test_a_pause_is_listed_with_what_the_method_did_across_it() -> None:
    lost = judged(make_recording(gap_s=1.0), lost=range(20, 24)).as_json()
    assert lost["gaps"][0]["across"] == "lost 4 frames, then found again"
    assert lost["gaps"][0]["error_m"] == pytest.approx(0.0, abs=1e-9)
    assert lost["why_lost"] == {"# of # matches agree": 4}
    anew = judged(make_recording(gap_s=1.0), lost=range(20, 24), epoch_from=24).as_json()
    assert anew["gaps"][0]["across"] == "lost 4 frames, then a new epoch"


def test_without_truth_there_is_coverage_and_no_error() -> None:
    figures = judged(make_recording(has_truth=False), lost=range(10)).as_json()
    assert figures["coverage"] == 0.75
    assert figures["no_evaluation"] == "there is no groundtruth.txt"
    assert [figures[key] for key in EVALUATION_KEYS if key != "coverage"] == [None] * 11
    assert figures["cpu_ms_per_frame"] == 8.0


def test_a_run_without_poses_or_with_too_few_says_why_it_is_not_judged() -> None:
    none = judged(make_recording(), lost=range(FRAMES))
    assert (none.coverage, none.no_evaluation_reason) == (0.0, "no frame has a pose")
    few = judged(make_recording(), lost=range(2, FRAMES))
    assert few.coverage == 0.05
    assert few.no_evaluation_reason.startswith(
        "2 of 2 poses have ground truth within 20 ms, 3 are needed"
    )


def test_a_crash_has_a_state_and_no_figures() -> None:
    figures = evaluate_run(BatchResult(make_recording(), "icp", CRASH)).as_json()
    assert (figures["state"], figures["trouble"]) == ("crashed", CRASH.error)
    assert figures["frames"] is figures["cpu_s"] is figures["coverage"] is None


def test_a_corrected_trajectory_is_judged_beside_the_methods_own() -> None:
    walk = make_recording()
    corrected = make_loop_closure_run(walk, STEP_M + 0.001)
    outcome = make_outcome(walk, step_m=STEP_M + 0.002, with_loops=corrected)
    figures = evaluate_run(BatchResult(walk, "surf", outcome, has_loop_closure=True)).as_json()
    assert figures["mean_global_error_m"] == pytest.approx(0.039)
    assert figures["optimized_mean_global_error_m"] == pytest.approx(0.0195)
    assert figures["optimized_ate_rmse_m"] < figures["ate_rmse_m"]
    assert [
        figures[key] for key in ("map_keyframes", "loop_closures", "loop_closure_ms_per_frame")
    ] == [3, 2, 1.5]


def test_keys_of_loops_are_there_if_they_were_asked_for_and_null_without_a_result() -> None:
    crashed = evaluate_run(
        BatchResult(make_recording(), "surf", CRASH, has_loop_closure=True)
    ).as_json()
    assert {key: crashed[key] for key in LOOP_CLOSURE_KEYS} == dict.fromkeys(LOOP_CLOSURE_KEYS)
    assert not set(LOOP_CLOSURE_KEYS) & set(judged(make_recording()).as_json())


def test_without_truth_loops_are_counted_and_not_judged() -> None:
    bare = make_recording(has_truth=False)
    entry = BatchResult(
        bare,
        "surf",
        make_outcome(bare, with_loops=make_loop_closure_run(bare)),
        has_loop_closure=True,
    )
    figures = evaluate_run(entry).as_json()
    assert (figures["loop_closures"], figures["optimized_ate_rmse_m"]) == (2, None)
