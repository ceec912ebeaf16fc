"""Summary of a recording's results in a few sentences."""

from vo_service.tools.benchmark.report.comparison_tables import MIN_FULL_COVERAGE
from vo_service.tools.benchmark.report.published_results import describe_method
from vo_service.tools.benchmark.results import MIN_RANKED_COVERAGE, RunEvaluation, SequenceResults


def summarize_sequence(result: SequenceResults) -> str:
    """Return sentences on the best method, low coverage and failed runs."""
    sentences = [
        _ranking_sentence(result),
        *_partial_coverage_sentences(result),
        *_failed_run_sentences(result),
    ]
    return " ".join(sentences)


def describe_rpe_without_gaps(result: SequenceResults) -> str:
    """Return a sentence on the RPE without pauses; "" if not known."""
    known = [
        f"{1e3 * evaluation.rpe_frame_without_gaps_m:.1f} mm for {describe_method(method).name}"
        for method, evaluation in result.evaluations.items()
        if evaluation.rpe_frame_without_gaps_m is not None
    ]
    return f" Without the pauses, the RPE of one frame is {', '.join(known)}." if known else ""


def _ranking_sentence(result: SequenceResults) -> str:
    known = sorted(
        (_error_m(evaluation), describe_method(method).name)
        for method, evaluation in result.evaluations.items()
        if evaluation.evaluation is not None and (evaluation.coverage or 0.0) >= MIN_RANKED_COVERAGE
    )
    if result.recording.truth is None:
        return "without ground truth, errors are not known."
    if not known:
        return "no method has poses for most of the frames."
    (smallest_m, best), *others = known
    if not others:
        return f"the mean global error of {best} is {1e3 * smallest_m:.2f} mm."
    rest = ", ".join(f"{name} {1e3 * error_m:.2f} mm" for error_m, name in others)
    return f"{best} has the smallest mean global error, {1e3 * smallest_m:.2f} mm; {rest}."


def _error_m(evaluation: RunEvaluation) -> float:
    assert evaluation.evaluation is not None
    return evaluation.evaluation.mean_global_error_m


def _partial_coverage_sentences(result: SequenceResults) -> list[str]:
    """Return a sentence for each method with incomplete coverage."""
    return [
        f"{describe_method(method).name} has poses for only "
        f"{100 * evaluation.coverage:.0f} % of the frames."
        for method, evaluation in result.evaluations.items()
        if evaluation.coverage is not None and evaluation.coverage < MIN_FULL_COVERAGE
    ]


def _failed_run_sentences(result: SequenceResults) -> list[str]:
    return [
        f"{describe_method(method).name} has no result ({evaluation.outcome.state})."
        for method, evaluation in result.evaluations.items()
        if not evaluation.is_done
    ]
