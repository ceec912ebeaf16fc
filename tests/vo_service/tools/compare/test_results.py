"""The metrics of simulated runs with known errors."""

from dataclasses import replace

import pytest

from tests.vo_service.tools.compare.sample_runs import (
    CRASH,
    FRAMES,
    STEP_M,
    make_loop_closure_run,
    make_outcome,
    make_recording,
)
from vo_service.tools.compare.recordings import BenchmarkRecording
from vo_service.tools.compare.results import RunEvaluation, evaluate_run


def evaluate_outcome(recording: BenchmarkRecording, **options: object) -> RunEvaluation:
    return evaluate_run(recording, make_outcome(recording, **options))


def test_a_run_is_evaluated_by_the_truth_of_its_recording() -> None:
    metrics = evaluate_outcome(make_recording(), step_m=STEP_M + 0.001).as_json()
    assert metrics["mean_global_error_m"] == pytest.approx(0.001 * (FRAMES - 1) / 2)
    assert metrics["rpe_frame_m"] == pytest.approx(0.001)
    assert (metrics["cpu_s"], metrics["wall_s"]) == (0.32, 0.4)
    assert (metrics["state"], metrics["gaps"], metrics["no_evaluation"]) == ("done", [], "")


def test_gross_errors_are_counted_but_not_at_a_new_epoch() -> None:
    assert evaluate_outcome(make_recording()).gross_errors == 0
    diverged = evaluate_outcome(
        make_recording(), step_m=STEP_M + 0.06, lost=range(20, 24), epoch_from=24
    )
    assert (diverged.gross_errors, diverged.steps) == (FRAMES - 4 - 2, FRAMES - 4 - 2)


def test_a_gap_is_listed_with_the_result_of_the_method() -> None:
    lost = evaluate_outcome(make_recording(gap_s=1.0), lost=range(20, 24)).as_json()
    assert lost["gaps"][0]["across"] == "lost 4 frames, then recovered"
    assert lost["gaps"][0]["error_m"] == pytest.approx(0.0, abs=1e-9)
    assert lost["why_lost"] == {"# of # matches agree": 4}
    reset = evaluate_outcome(make_recording(gap_s=1.0), lost=range(20, 24), epoch_from=24).as_json()
    assert reset["gaps"][0]["across"] == "lost 4 frames, then a new epoch"


def test_the_reason_for_a_degraded_pose_is_not_one_for_a_lost_frame() -> None:
    outcome = make_outcome(make_recording(), lost=range(20, 24))
    frames = outcome.run.frames.copy()
    frames["reason"] = ["no texture"] * 20 + ["lost at 3"] * 20
    degraded = replace(outcome, run=replace(outcome.run, frames=frames))
    judged = evaluate_run(make_recording(), degraded)
    assert judged.lost_reasons == [("lost at #", 4)]


def test_a_run_with_too_few_poses_has_a_reason_for_no_evaluation() -> None:
    crashed = evaluate_run(make_recording(), CRASH)
    assert (crashed.coverage, crashed.no_evaluation_reason) == (None, "the run has no result")
    none = evaluate_outcome(make_recording(), lost=range(FRAMES))
    assert (none.coverage, none.no_evaluation_reason) == (0.0, "no frame has a pose")
    few = evaluate_outcome(make_recording(), lost=range(2, FRAMES))
    assert few.coverage == 0.05
    assert few.no_evaluation_reason.startswith(
        "2 of 2 poses have ground truth within 20 ms, 3 are needed"
    )


def test_without_a_truth_coverage_and_times_are_known() -> None:
    bare = evaluate_outcome(make_recording(has_truth=False), lost=range(10, FRAMES))
    assert (bare.coverage, bare.evaluation, bare.gross_errors) == (0.25, None, None)
    assert bare.no_evaluation_reason == "there is no groundtruth.txt"
    assert bare.as_json()["cpu_s"] == 0.32


def test_an_optimized_trajectory_is_evaluated_beside_the_methods_own() -> None:
    walk = make_recording()
    loop_closure = make_loop_closure_run(walk, STEP_M + 0.001)
    judged = evaluate_outcome(walk, step_m=STEP_M + 0.002, loop_closure=loop_closure)
    assert judged.evaluation is not None
    assert judged.optimized_evaluation is not None
    assert judged.evaluation.mean_global_error_m == pytest.approx(0.039)
    assert judged.optimized_evaluation.mean_global_error_m == pytest.approx(0.0195)
    bare = make_recording(has_truth=False)
    loop_closure = make_loop_closure_run(bare)
    assert evaluate_outcome(bare, loop_closure=loop_closure).optimized_evaluation is None
