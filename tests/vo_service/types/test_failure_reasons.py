"""A run without poses tells its most frequent reason."""

from vo_service.types.failure_reasons import FailureReasons


def make_reasons(*reasons: str) -> FailureReasons:
    """Make the reasons of a run; "" is a frame with a pose."""
    counted = FailureReasons()
    for reason in reasons:
        counted.add(not reason, reason)
    return counted


def test_the_most_frequent_reason_is_named_whatever_its_numbers() -> None:
    reasons = make_reasons("", "no depth", "3 of 9 agree", "4 of 8 agree")
    assert reasons.no_motion_reason == (
        "none of 4 frames could be tracked; the most frequent reason (2 of 4): 3 of 9 agree; "
        "check the images and the camera file"
    )


def test_a_run_with_a_pose_has_no_reason() -> None:
    assert make_reasons("", "", "no depth", "no depth").no_motion_reason == ""
    assert make_reasons("").no_motion_reason == make_reasons().no_motion_reason == ""


def test_a_run_whose_first_frame_failed_has_a_reason() -> None:
    assert "(1 of 1): no depth" in make_reasons("no depth").no_motion_reason
