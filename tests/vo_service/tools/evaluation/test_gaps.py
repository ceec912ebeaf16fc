"""Gaps in a recording, and how an odometry crosses them."""

import numpy as np
import pytest

from tests.vo_service.tools.evaluation.sample_trajectories import match_poses, moving_along_x
from vo_service.tools.evaluation.gaps import Gap, classify_gap, find_gaps, gap_error, spans_gap
from vo_service.tools.evaluation.metrics import consecutive_pairs

STAMPS_S = np.array([0.0, 0.1, 0.2, 1.2, 1.3, 1.4])
GAP = Gap(0.2, 1.2)


@pytest.mark.parametrize(
    ("steps_s", "lengths_s"),
    [
        ([0.03] * 5 + [0.19] + [0.03] * 5, []),  # more than three median steps, but short
        ([0.03] * 5 + [0.21] + [0.03] * 5, [0.21]),
        ([0.1] * 5 + [0.29] + [0.1] * 5, []),  # long, but less than three median steps
        ([0.1] * 5 + [0.31, 0.1, 2.0], [0.31, 2.0]),
        ([], []),
    ],
)
def test_a_gap_is_longer_than_median_steps_and_than_a_fifth_of_a_second(
    steps_s: list[float], lengths_s: list[float]
) -> None:
    stamps_s = 100.0 + np.cumsum([0.0, *steps_s])
    assert [gap.length_s for gap in find_gaps(stamps_s)] == pytest.approx(lengths_s)
    assert find_gaps(STAMPS_S) == [GAP]
    assert find_gaps(np.empty(0)) == []


@pytest.mark.parametrize(
    ("good", "epochs", "text"),
    [
        ("gggggg", "000000", "kept tracking"),
        ("ggg-gg", "000000", "lost 1 frame, then recovered"),
        ("ggg--g", "000001", "lost 2 frames, then a new epoch"),
        ("gggggg", "000111", "new epoch at once"),
        ("ggg---", "000000", "lost to the end (3 frames)"),
        ("gg-ggg", "000000", "already lost before it; kept tracking"),
        ("gg----", "000000", "already lost before it; lost to the end (3 frames)"),
    ],
)
def test_the_outcome_of_a_gap_as_text(good: str, epochs: str, text: str) -> None:
    is_good = np.array([letter == "g" for letter in good])
    assert str(classify_gap(GAP, STAMPS_S, is_good, np.array([int(e) for e in epochs]))) == text


def test_unreadable_frames_do_not_count() -> None:
    read = [0, 1, 4, 5]  # without the two beside the gap
    outcome = classify_gap(GAP, STAMPS_S[read], np.full(4, True), np.zeros(4, np.int64))
    assert str(outcome) == "kept tracking"


TRUTH_X_M = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
WALK_X_M = [0.0, 0.1, 0.2, 0.31, 0.41, 0.51]  # 1 cm too far across the gap


def test_the_error_across_a_gap_is_that_of_the_motion_between_its_poses() -> None:
    tracked = [0, 1, 2, 4, 5]  # the first after the gap is lost
    walk, truth = moving_along_x(WALK_X_M)[tracked], moving_along_x(TRUTH_X_M)[tracked]
    poses = match_poses(list(STAMPS_S[tracked]), walk, truth)
    error = gap_error(poses, GAP)
    assert error is not None
    assert error.translation_m == pytest.approx([0.01])
    assert error.rotation_deg == pytest.approx([0.0])
    is_across = spans_gap(poses, consecutive_pairs(poses), [GAP])
    assert is_across.tolist() == [False, False, True, False]


@pytest.mark.parametrize("tracked", [[0, 1, 2], [3, 4, 5]])
def test_there_is_no_error_if_one_side_has_no_pose(tracked: list[int]) -> None:
    indices = np.array(tracked)
    poses = match_poses(
        list(STAMPS_S[indices]), moving_along_x([0.0, 0.1, 0.2]), moving_along_x([0.0, 0.1, 0.2])
    )
    assert gap_error(poses, GAP) is None
    assert not spans_gap(poses, consecutive_pairs(poses), [GAP]).any()
