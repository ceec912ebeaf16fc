"""Steps with gross errors while the odometry reports that it is tracking."""

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform, so3_exp
from drivers.core.trajectory import Trajectory
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.gross_errors import count_gross_errors, tracked_steps

COUNT = 10
STAMPS_S = np.arange(COUNT) / 30
STATIC_POSES = np.tile(np.eye(4), (COUNT, 1, 1))


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


def test_a_jump_into_a_new_epoch_is_not_gross() -> None:
    assert count_errors_and_steps(jump(1.0), epoch_from=5) == (0, COUNT - 2)


def test_a_jump_over_lost_frames_in_one_epoch_is_gross() -> None:
    assert count_errors_and_steps(jump(1.0), tracked=[0, 1, 2, 3, 7, 8, 9]) == (1, 6)


def test_steps_without_truth_in_between_do_not_count() -> None:
    truth = Trajectory(STAMPS_S[[0, 1, 2, 7, 8, 9]], STATIC_POSES[[0, 1, 2, 7, 8, 9]])
    trajectory = Trajectory(STAMPS_S, jump(1.0))
    matched = associate(trajectory, truth)
    steps = tracked_steps(matched, STAMPS_S, np.zeros(COUNT, np.int64))
    assert (count_gross_errors(matched, steps), len(steps)) == (0, 4)
