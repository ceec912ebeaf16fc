"""What a recording shows, in a sentence or two."""

from vo_service.comparison.paper import about
from vo_service.comparison.tables import WHOLE
from vo_service.runs.judging import Judgement
from vo_service.runs.results import MOST_FRAMES, SequenceResults


def finding(result: SequenceResults) -> str:
    """Which method was nearest to the truth, and which did not come through."""
    sentences = [_order(result), *_partial(result), *_without_result(result)]
    return " ".join(sentences)


def without_pauses(result: SequenceResults) -> str:
    """The error of a step where the recording does not pause; "" where it is not known."""
    known = [
        f"{1e3 * judged.rpe_frame_without_gaps_m:.1f} mm for {about(method).name}"
        for method, judged in result.judged.items()
        if judged.rpe_frame_without_gaps_m is not None
    ]
    return f" Without the pauses, the RPE of one frame is {', '.join(known)}." if known else ""


def _order(result: SequenceResults) -> str:
    known = sorted(
        (_error_m(judged), about(method).name)
        for method, judged in result.judged.items()
        if judged.evaluation is not None and (judged.coverage or 0.0) >= MOST_FRAMES
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


def _error_m(judged: Judgement) -> float:
    assert judged.evaluation is not None
    return judged.evaluation.mean_global_error_m


def _partial(result: SequenceResults) -> list[str]:
    """Methods that lost more than a few frames: their errors are taken over the others."""
    return [
        f"{about(method).name} placed {100 * judged.coverage:.0f} % of the frames only."
        for method, judged in result.judged.items()
        if judged.coverage is not None and judged.coverage < WHOLE
    ]


def _without_result(result: SequenceResults) -> list[str]:
    return [
        f"{about(method).name} has no result ({judged.outcome.state})."
        for method, judged in result.judged.items()
        if not judged.is_done
    ]
