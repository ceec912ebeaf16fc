"""What a recording shows, in a sentence or two."""

from vo_service.tools.benchmark.evaluate_run import RunEvaluation
from vo_service.tools.benchmark.report.comparison_tables import MIN_FULL_COVERAGE
from vo_service.tools.benchmark.report.published_results import describe_method
from vo_service.tools.benchmark.results import MIN_RANKED_COVERAGE, SequenceResults


def summarize_sequence(result: SequenceResults) -> str:
    """Which method was nearest to the truth, and which did not come through."""
    sentences = [
        _ranking_sentence(result),
        *_partial_coverage_sentences(result),
        *_failed_run_sentences(result),
    ]
    return " ".join(sentences)


def describe_rpe_without_gaps(result: SequenceResults) -> str:
    """The error of a step where the recording does not pause; "" where it is not known."""
    known = [
        f"{1e3 * judged.rpe_frame_without_gaps_m:.1f} mm for {describe_method(method).name}"
        for method, judged in result.evaluations.items()
        if judged.rpe_frame_without_gaps_m is not None
    ]
    return f" Without the pauses, the RPE of one frame is {', '.join(known)}." if known else ""


def _ranking_sentence(result: SequenceResults) -> str:
    known = sorted(
        (_error_m(judged), describe_method(method).name)
        for method, judged in result.evaluations.items()
        if judged.evaluation is not None and (judged.coverage or 0.0) >= MIN_RANKED_COVERAGE
    )
    if result.recording.truth is None:
        return "without ground truth, errors cannot be told."
    if not known:
        return "no method could be judged over most of the frames."
    (least_m, best), *others = known
    if not others:
        return f"the mean global error of {best} is {1e3 * least_m:.2f} mm."
    rest = ", ".join(f"{name} {1e3 * error_m:.2f} mm" for error_m, name in others)
    return f"{best} has the smallest mean global error, {1e3 * least_m:.2f} mm; {rest}."


def _error_m(evaluation: RunEvaluation) -> float:
    assert evaluation.evaluation is not None
    return evaluation.evaluation.mean_global_error_m


def _partial_coverage_sentences(result: SequenceResults) -> list[str]:
    """Methods that lost more than a few frames: their errors are taken over the others."""
    return [
        f"{describe_method(method).name} placed {100 * judged.coverage:.0f} % of the frames only."
        for method, judged in result.evaluations.items()
        if judged.coverage is not None and judged.coverage < MIN_FULL_COVERAGE
    ]


def _failed_run_sentences(result: SequenceResults) -> list[str]:
    return [
        f"{describe_method(method).name} has no result ({judged.outcome.state})."
        for method, judged in result.evaluations.items()
        if not judged.is_done
    ]
