"""Association of poses with the truth, and coverage of the frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.core.geometry import nearest_indices
from tests.vo_service.tools.evaluation.sample_trajectories import poses_at
from vo_service.tools.evaluation.metrics import associate, coverage

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


def test_no_overlap_gives_the_same_error_with_the_smallest_difference() -> None:
    with pytest.raises(InputError, match=r"^0 of 3 poses .* truth 50.*; the two closest are 48.0"):
        associate(poses_at([0.0, 1.0, 2.0]), poses_at([50.0, 51.0, 52.0, 53.0]))


def test_a_larger_difference_is_allowed_on_request() -> None:
    poses = poses_at([0.0, 1.0, 2.0])
    truth = poses_at([0.04, 1.04, 2.04])
    assert len(associate(poses, truth, max_difference_s=0.05).stamps_s) == 3
    assert coverage(poses.stamps_s, truth.stamps_s, poses.stamps_s, 0.05) == 1.0
    with pytest.raises(InputError, match="within 20 ms"):
        associate(poses, truth)


def test_an_empty_trajectory_gives_the_same_error() -> None:
    with pytest.raises(InputError, match=r"^0 of 0 poses .* \(trajectory empty, truth 0.000"):
        associate(poses_at([]), poses_at([0.0, 1.0, 2.0]))


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


def test_truth_at_the_stamp_of_every_pose_counts_as_the_frames() -> None:
    truth_s = np.arange(30) / 30
    assert coverage(np.round(truth_s[::2], 4), truth_s, None) == 0.5


def test_motion_capture_alone_gives_no_coverage() -> None:
    assert coverage(np.arange(30) / 30 + 0.002, np.arange(100) / 100, None) is None


def test_frames_without_any_truth_give_no_coverage() -> None:
    assert coverage(np.arange(5.0), np.arange(5.0), np.arange(100.0, 105.0)) is None
