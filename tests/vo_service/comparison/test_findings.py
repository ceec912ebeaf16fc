"""What a recording shows, in a sentence or two."""

from tests.vo_service.runs.made_up import CRASH, STEP_M, done, recording, results
from vo_service.comparison.findings import finding, without_pauses


def test_the_finding_names_the_best_the_partial_and_the_missing() -> None:
    walk = recording()
    text = finding(
        results(walk, icp=done(walk, step_m=0.02), surf=done(walk, lost=range(4)), sfm=CRASH)
    )
    assert text == (
        "SURF (proposed) has the smallest mean global error, 0.00 mm; ICP 195.00 mm. "
        "SURF (proposed) placed 90 % of the frames only. SfM has no result (crashed)."
    )


def test_the_finding_says_so_where_errors_cannot_be_told() -> None:
    bare = recording(has_truth=False)
    assert finding(results(bare, surf=done(bare))) == (
        "without ground truth, errors cannot be told."
    )
    assert finding(results(recording(), surf=CRASH)).startswith("no method could be judged")


def test_the_error_of_a_step_is_also_told_without_the_pauses() -> None:
    walk = recording(gap_s=1.0)
    text = without_pauses(results(walk, surf=done(walk, step_m=STEP_M + 0.001)))
    assert text == " Without the pauses, the RPE of one frame is 1.0 mm for SURF (proposed)."
