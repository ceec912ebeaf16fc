"""Summary of a recording's results."""

from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    STEP_M,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.benchmark.report.comparison_report import (
    describe_rpe_without_gaps,
    summarize_sequence,
)


def test_the_summary_names_the_best_the_partial_and_the_failed() -> None:
    walk = make_recording()
    text = summarize_sequence(
        make_results(
            walk,
            icp=make_outcome(walk, step_m=0.02),
            surf=make_outcome(walk, lost=range(4)),
            sfm=CRASH,
        )
    )
    assert text == (
        "SURF (proposed) has the smallest mean global error, 0.00 mm; ICP 195.00 mm. "
        "SURF (proposed) has poses for only 90 % of the frames. SfM has no result (crashed)."
    )


def test_the_summary_says_if_errors_are_not_known() -> None:
    recording = make_recording(has_truth=False)
    assert summarize_sequence(make_results(recording, surf=make_outcome(recording))) == (
        "without ground truth, errors are not known."
    )
    assert summarize_sequence(make_results(make_recording(), surf=CRASH)).startswith(
        "no method has poses for most"
    )


def test_the_rpe_is_also_given_without_pauses() -> None:
    walk = make_recording(gap_s=1.0)
    text = describe_rpe_without_gaps(
        make_results(walk, surf=make_outcome(walk, step_m=STEP_M + 0.001))
    )
    assert text == " Without the pauses, the RPE of one frame is 1.0 mm for SURF (proposed)."
