"""The metrics of simulated runs with known errors."""

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
from vo_service.tools.benchmark.recordings import BenchmarkRecording
from vo_service.tools.benchmark.results import (
    EVALUATION_KEYS,
    LOOP_CLOSURE_KEYS,
    RunEvaluation,
    evaluate_run,
)


def evaluate_outcome(recording: BenchmarkRecording, **options: object) -> RunEvaluation:
    return evaluate_run(BatchResult(recording, "surf", make_outcome(recording, **options)))


def test_a_run_is_evaluated_by_the_truth_of_its_recording() -> None:
    metrics = evaluate_outcome(make_recording(), step_m=STEP_M + 0.001).as_json()
    assert metrics["mean_global_error_m"] == pytest.approx(0.001 * (FRAMES - 1) / 2)
    assert metrics["rpe_frame_m"] == pytest.approx(0.001)
    assert (metrics["coverage"], metrics["cpu_s"], metrics["wall_s"]) == (1.0, 0.32, 0.4)
    assert (metrics["state"], metrics["gaps"], metrics["no_evaluation"]) == ("done", [], "")


def test_gross_errors_are_counted_but_not_at_a_new_epoch() -> None:
    assert evaluate_outcome(make_recording()).gross_errors == 0
    diverged = evaluate_outcome(
        make_recording(), step_m=STEP_M + 0.06, lost=range(20, 24), epoch_from=24
    )
    assert (diverged.gross_errors, diverged.steps) == (FRAMES - 4 - 2, FRAMES - 4 - 2)
    assert diverged.as_json()["gross_errors"] == diverged.gross_errors


def test_a_gap_is_listed_with_the_result_of_the_method() -> None:
    lost = evaluate_outcome(make_recording(gap_s=1.0), lost=range(20, 24)).as_json()
    assert lost["gaps"][0]["across"] == "lost 4 frames, then recovered"
    assert lost["gaps"][0]["error_m"] == pytest.approx(0.0, abs=1e-9)
    assert lost["why_lost"] == {"# of # matches agree": 4}
    reset = evaluate_outcome(make_recording(gap_s=1.0), lost=range(20, 24), epoch_from=24).as_json()
    assert reset["gaps"][0]["across"] == "lost 4 frames, then a new epoch"


def test_without_truth_there_is_coverage_and_no_error() -> None:
    metrics = evaluate_outcome(make_recording(has_truth=False), lost=range(10)).as_json()
    assert metrics["coverage"] == 0.75
    assert metrics["no_evaluation"] == "there is no groundtruth.txt"
    assert [metrics[key] for key in EVALUATION_KEYS if key != "coverage"] == [None] * 11
    assert metrics["cpu_ms_per_frame"] == 8.0


def test_a_run_with_too_few_poses_has_a_reason_for_no_evaluation() -> None:
    none = evaluate_outcome(make_recording(), lost=range(FRAMES))
    assert (none.coverage, none.no_evaluation_reason) == (0.0, "no frame has a pose")
    few = evaluate_outcome(make_recording(), lost=range(2, FRAMES))
    assert few.coverage == 0.05
    assert few.no_evaluation_reason.startswith(
        "2 of 2 poses have ground truth within 20 ms, 3 are needed"
    )


def test_a_crash_has_a_state_and_no_metrics() -> None:
    metrics = evaluate_run(BatchResult(make_recording(), "icp", CRASH)).as_json()
    assert (metrics["state"], metrics["error"]) == ("crashed", CRASH.error)
    assert metrics["frames"] is metrics["cpu_s"] is metrics["coverage"] is None


def test_an_optimized_trajectory_is_evaluated_beside_the_methods_own() -> None:
    walk = make_recording()
    loop_closure = make_loop_closure_run(walk, STEP_M + 0.001)
    outcome = make_outcome(walk, step_m=STEP_M + 0.002, loop_closure=loop_closure)
    metrics = evaluate_run(BatchResult(walk, "surf", outcome, has_loop_closure=True)).as_json()
    assert metrics["mean_global_error_m"] == pytest.approx(0.039)
    assert metrics["optimized_mean_global_error_m"] == pytest.approx(0.0195)
    assert metrics["optimized_ate_rmse_m"] < metrics["ate_rmse_m"]
    assert [
        metrics[key] for key in ("map_keyframes", "loop_closures", "loop_closure_ms_per_frame")
    ] == [3, 2, 1.5]


def test_loop_closure_keys_exist_if_it_was_enabled_and_are_null_without_a_result() -> None:
    crashed = evaluate_run(
        BatchResult(make_recording(), "surf", CRASH, has_loop_closure=True)
    ).as_json()
    assert {key: crashed[key] for key in LOOP_CLOSURE_KEYS} == dict.fromkeys(LOOP_CLOSURE_KEYS)
    assert not set(LOOP_CLOSURE_KEYS) & set(evaluate_outcome(make_recording()).as_json())


def test_without_truth_loop_closures_are_counted_and_not_evaluated() -> None:
    recording = make_recording(has_truth=False)
    result = BatchResult(
        recording,
        "surf",
        make_outcome(recording, loop_closure=make_loop_closure_run(recording)),
        has_loop_closure=True,
    )
    metrics = evaluate_run(result).as_json()
    assert (metrics["loop_closures"], metrics["optimized_ate_rmse_m"]) == (2, None)
