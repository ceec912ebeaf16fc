"""What a recording shows, in a sentence or two."""

from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    STEP_M,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.benchmark.report.summary_text import (
    describe_rpe_without_gaps,
    summarize_sequence,
)


def test_the_finding_names_the_best_the_partial_and_the_missing() -> None:
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
        "SURF (proposed) placed 90 % of the frames only. SfM has no result (crashed)."
    )


def test_the_finding_says_so_where_errors_cannot_be_told() -> None:
    bare = make_recording(has_truth=False)
    assert summarize_sequence(make_results(bare, surf=make_outcome(bare))) == (
        "without ground truth, errors cannot be told."
    )
    assert summarize_sequence(make_results(make_recording(), surf=CRASH)).startswith(
        "no method could be judged"
    )


def test_the_error_of_a_step_is_also_told_without_the_pauses() -> None:
    walk = make_recording(gap_s=1.0)
    text = describe_rpe_without_gaps(
        make_results(walk, surf=make_outcome(walk, step_m=STEP_M + 0.001))
    )
    assert text == " Without the pauses, the RPE of one frame is 1.0 mm for SURF (proposed)."
