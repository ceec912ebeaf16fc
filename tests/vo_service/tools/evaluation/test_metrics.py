"""Association, coverage, errors of motions that can be calculated by hand, and consistency."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.core.geometry import Trajectory, nearest_indices, rigid_transform, so3_exp
from tests.vo_service.tools.evaluation.sample_trajectories import (
    match_poses,
    moving_along_x,
    poses_at,
)
from vo_service.tools.evaluation.metrics import (
    associate,
    best_alignment,
    count_gross_errors,
    coverage,
    first_pose_alignment,
    pairs_one_second_apart,
    position_errors_m,
    relative_errors,
    rms,
    tracked_steps,
)

OTHER_WORLD = rigid_transform(so3_exp([0.5, -1.0, 2.0]), [3.0, -4.0, 5.0])
COUNT = 10
STAMPS_S = np.arange(COUNT) / 30
STATIC_POSES = np.tile(np.eye(4), (COUNT, 1, 1))


def one_second_pairs(stamps_s: list[float]) -> list[tuple[int, int]]:
    still = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    pairs = pairs_one_second_apart(match_poses(stamps_s, still, still))
    return list(zip(pairs.earlier.tolist(), pairs.later.tolist(), strict=True))


def test_a_mirrored_trajectory_is_not_mirrored_back() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]])
    truth = np.tile(np.eye(4), (4, 1, 1))
    truth[:, :3, 3] = corners
    mirrored = truth.copy()
    mirrored[:, 0, 3] *= -1
    pairs = match_poses([0, 1, 2, 3], mirrored, truth)
    alignment = best_alignment(pairs)
    assert np.linalg.det(alignment[:3, :3]) == pytest.approx(1)
    assert position_errors_m(pairs, alignment).max() > 0.1


@pytest.mark.parametrize("x_m", [[2.0, 2.0, 2.0], [0.0, 1.0, 2.0]])
def test_standing_still_or_going_straight_can_be_aligned(x_m: list[float]) -> None:
    pairs = match_poses([0, 1, 2], moving_along_x(x_m), OTHER_WORLD @ moving_along_x(x_m))
    assert position_errors_m(pairs, best_alignment(pairs)) == pytest.approx(np.zeros(3), abs=1e-12)


def test_first_pose_alignment_turns_a_wrong_heading_into_an_error() -> None:
    # The positions are right, but the heading is 90 degrees off.
    truth = moving_along_x([0, 1, 2])
    heading = rigid_transform(so3_exp([0, 0, np.pi / 2]), [0, 0, 0])
    estimated = truth @ heading
    pairs = match_poses([0, 1, 2], estimated, truth)
    expected_m = [0, np.sqrt(2), 2 * np.sqrt(2)]
    assert position_errors_m(pairs, first_pose_alignment(pairs)) == pytest.approx(expected_m)


@pytest.mark.parametrize(
    ("stamps_s", "pairs"),
    [
        ([0, 0.5, 1.0, 1.5, 2.0], [(0, 2), (1, 3), (2, 4)]),
        ([0, 0.5, 0.96, 1.03, 1.58], [(0, 3), (1, 4)]),  # the nearest
        ([0, 0.5, 1.2, 1.5, 2.2], [(1, 3), (2, 4)]),  # none within a gap
        ([0, 0.3, 0.6, 0.95], []),
        ([1305031449.1 + k / 30 for k in range(70)], [(k, k + 30) for k in range(40)]),
    ],
)
def test_every_pose_is_paired_with_the_one_a_second_later(
    stamps_s: list[float], pairs: list[tuple[int, int]]
) -> None:
    assert one_second_pairs([round(stamp_s, 6) for stamp_s in stamps_s]) == pairs


def test_the_error_over_a_second_by_hand() -> None:
    # Errors of 0.3, 0 and 0.4 m and of 10, 0 and 20 degrees: sqrt(.25 / 3), sqrt(500 / 3).
    trajectory = moving_along_x([0, 0.3, 0.3, 0.7], [0, 10, 10, 30])
    pairs = match_poses([0, 1, 2, 3], trajectory, moving_along_x([0, 0, 0, 0]))
    errors = relative_errors(pairs, pairs_one_second_apart(pairs))
    assert rms(errors.translation_m) == pytest.approx(0.2886751)
    assert rms(errors.rotation_deg) == pytest.approx(12.9099445)
    assert rms(np.array([])) is None


def count_errors_and_steps(
    poses: np.ndarray, tracked: list[int] | None = None, epoch_from: int = COUNT
) -> tuple[int, int]:
    """Return the number of gross errors and of steps; the true camera does not move."""
    indices = np.arange(COUNT) if tracked is None else np.array(tracked)
    trajectory = Trajectory(STAMPS_S[indices], poses[indices])
    matched = associate(trajectory, Trajectory(STAMPS_S, STATIC_POSES))
    steps = tracked_steps(matched, trajectory.stamps_s, (indices >= epoch_from).astype(np.int64))
    return count_gross_errors(matched, steps), len(steps)


def jump(meters: float = 0.0, degrees: float = 0.0, at: int = 5) -> np.ndarray:
    """Make static poses with one wrong step."""
    turn = so3_exp([0.0, np.radians(degrees), 0.0])
    poses = STATIC_POSES.copy()
    poses[at:] = rigid_transform(turn, [meters, 0.0, 0.0])
    return poses


@pytest.mark.parametrize(
    ("meters", "degrees", "gross"),
    [(0.0, 0.0, 0), (0.049, 2.9, 0), (0.051, 0.0, 1), (0.0, 3.1, 1), (0.2, 20.0, 1)],
)
def test_a_step_is_gross_from_5_cm_or_3_degrees_on(
    meters: float, degrees: float, gross: int
) -> None:
    assert count_errors_and_steps(jump(meters, degrees)) == (gross, COUNT - 1)


def test_small_errors_that_add_up_are_drift_and_not_gross() -> None:
    drifting_poses = STATIC_POSES.copy()
    drifting_poses[:, 0, 3] = 0.04 * np.arange(COUNT)
    assert count_errors_and_steps(drifting_poses) == (0, COUNT - 1)


def test_a_jump_is_gross_over_lost_frames_but_not_into_a_new_epoch() -> None:
    assert count_errors_and_steps(jump(1.0), tracked=[0, 1, 2, 3, 7, 8, 9]) == (1, 6)
    assert count_errors_and_steps(jump(1.0), epoch_from=5) == (0, COUNT - 2)


def test_steps_without_truth_in_between_do_not_count() -> None:
    truth = Trajectory(STAMPS_S[[0, 1, 2, 7, 8, 9]], STATIC_POSES[[0, 1, 2, 7, 8, 9]])
    trajectory = Trajectory(STAMPS_S, jump(1.0))
    matched = associate(trajectory, truth)
    steps = tracked_steps(matched, STAMPS_S, np.zeros(COUNT, np.int64))
    assert (count_gross_errors(matched, steps), len(steps)) == (0, 4)


stamps = st.lists(st.integers(0, 2000), min_size=1, max_size=30, unique=True).map(
    lambda milliseconds: np.array(sorted(milliseconds)) / 1000.0
)


@given(stamps, stamps)
def test_the_nearest_is_that_of_an_exhaustive_search(
    stamps_s: np.ndarray, wanted_s: np.ndarray
) -> None:
    nearest = nearest_indices(stamps_s, wanted_s)
    distances_s = np.abs(stamps_s[None] - wanted_s[:, None])
    assert np.allclose(
        np.abs(stamps_s[nearest] - wanted_s), distances_s.min(axis=1), rtol=0, atol=1e-12
    )


def test_of_two_equally_near_stamps_the_earlier_is_taken() -> None:
    assert nearest_indices(np.array([0.0, 1.0, 2.0]), np.array([0.5, 1.5])).tolist() == [0, 1]


def test_each_pose_takes_the_nearest_truth_within_20_ms() -> None:
    truth = poses_at([0.00, 0.01, 0.02, 0.03, 0.10, 0.20, 0.30])
    truth.T_world_camera[:, 0, 3] = range(7)
    pairs = associate(poses_at([0.011, 0.026, 0.119, 0.221, 0.281]), truth)
    assert pairs.stamps_s.tolist() == [0.011, 0.026, 0.119, 0.281]
    assert pairs.T_truth_camera[:, 0, 3].tolist() == [1, 3, 4, 6]


def test_each_truth_takes_the_nearest_pose_where_there_are_fewer_truths() -> None:
    trajectory = poses_at([0.0, 0.033, 0.066, 0.1, 0.133, 0.166, 0.2])
    trajectory.T_world_camera[:, 0, 3] = range(7)
    pairs = associate(trajectory, poses_at([0.001, 0.101, 0.201]))
    assert pairs.T_world_camera[:, 0, 3].tolist() == [0, 3, 6]
    assert len(pairs.T_truth_camera) == 3


def test_too_few_pairs_are_one_line() -> None:
    with pytest.raises(InputError) as caught:
        associate(poses_at([0.0, 1.0, 2.0, 3.0]), poses_at([0.0, 1.0, 2.5, 3.5, 10.0]))
    assert str(caught.value) == (
        "2 of 4 poses have ground truth within 20 ms, 3 are needed "
        "(trajectory 0.000..3.000 s, truth 0.000..10.000 s; the two closest are 0.000 s apart); "
        "use the truth of the same recording, on the same clock"
    )


@pytest.mark.parametrize(
    ("stamps_s", "message"),
    [
        ([0.0, 1.0, 2.0], r"^0 of 3 poses .* truth 50.*; the two closest are 48.0"),
        ([], r"^0 of 0 poses .* \(trajectory empty, truth 50.000"),
    ],
)
def test_without_overlap_the_error_names_the_smallest_difference(
    stamps_s: list[float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        associate(poses_at(stamps_s), poses_at([50.0, 51.0, 52.0, 53.0]))


def test_a_larger_difference_is_allowed_on_request() -> None:
    poses = poses_at([0.0, 1.0, 2.0])
    truth = poses_at([0.04, 1.04, 2.04])
    assert len(associate(poses, truth, max_difference_s=0.05).stamps_s) == 3
    assert coverage(poses.stamps_s, truth.stamps_s, poses.stamps_s, 0.05) == 1.0
    with pytest.raises(InputError, match="within 20 ms"):
        associate(poses, truth)


def test_coverage_counts_only_frames_and_poses_that_have_truth() -> None:
    frames_s = np.arange(10) / 10  # truth begins at the fifth
    truth_s = np.arange(40, 100) / 100
    poses_s = frames_s[[0, 1, 4, 5, 6]]
    assert coverage(poses_s, truth_s, frames_s) == 3 / 6


def test_coverage_is_the_same_however_dense_the_truth() -> None:
    frames_s = np.arange(90) / 30
    poses_s = np.delete(frames_s, [10, 11, 40])
    for rate in (20, 30, 100, 200):
        truth_s = np.arange(3 * rate) / rate
        assert coverage(poses_s, truth_s, frames_s) == pytest.approx(87 / 90, abs=0.002)


def test_without_frames_truth_at_the_stamp_of_every_pose_counts_as_frames() -> None:
    truth_s = np.arange(30) / 30
    assert coverage(np.round(truth_s[::2], 4), truth_s, None) == 0.5
    assert coverage(np.arange(30) / 30 + 0.002, np.arange(100) / 100, None) is None


def test_frames_without_any_truth_give_no_coverage() -> None:
    assert coverage(np.arange(5.0), np.arange(5.0), np.arange(100.0, 105.0)) is None
