"""Steps that are grossly wrong while the odometry calls itself tracking."""

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform, so3_exp
from drivers.core.trajectory import Trajectory
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.gross_errors import count_gross_errors, tracked_steps

COUNT = 10
STAMPS_S = np.arange(COUNT) / 30
STANDING = np.tile(np.eye(4), (COUNT, 1, 1))


def judged(
    poses: np.ndarray, kept: list[int] | None = None, epoch_from: int = COUNT
) -> tuple[int, int]:
    """Gross errors and steps of poses, as far as they are kept, of a camera that stands still."""
    chosen = np.arange(COUNT) if kept is None else np.array(kept)
    trajectory = Trajectory(STAMPS_S[chosen], poses[chosen])
    matched = associate(trajectory, Trajectory(STAMPS_S, STANDING))
    steps = tracked_steps(matched, trajectory.stamps_s, (chosen >= epoch_from).astype(np.int64))
    return count_gross_errors(matched, steps), len(steps)


def jump(metres: float = 0.0, degrees: float = 0.0, at: int = 5) -> np.ndarray:
    """Standing still but for one step that never was."""
    turn = so3_exp([0.0, np.radians(degrees), 0.0])
    poses = STANDING.copy()
    poses[at:] = rigid_transform(turn, [metres, 0.0, 0.0])
    return poses


@pytest.mark.parametrize(
    ("metres", "degrees", "gross"),
    [(0.0, 0.0, 0), (0.049, 2.9, 0), (0.051, 0.0, 1), (0.0, 3.1, 1), (0.2, 20.0, 1)],
)
def test_a_step_is_gross_from_5_cm_or_3_degrees_on(
    metres: float, degrees: float, gross: int
) -> None:
    assert judged(jump(metres, degrees)) == (gross, COUNT - 1)


def test_small_errors_that_add_up_are_drift_and_not_gross() -> None:
    drifting = STANDING.copy()
    drifting[:, 0, 3] = 0.04 * np.arange(COUNT)
    assert judged(drifting) == (0, COUNT - 1)


def test_a_jump_that_a_new_epoch_admits_is_not_gross() -> None:
    assert judged(jump(1.0), epoch_from=5) == (0, COUNT - 2)


def test_a_jump_over_lost_frames_is_gross_when_it_is_called_the_same_way() -> None:
    assert judged(jump(1.0), kept=[0, 1, 2, 3, 7, 8, 9]) == (1, 6)


def test_where_the_truth_is_missing_in_between_no_step_is_judged() -> None:
    truth = Trajectory(STAMPS_S[[0, 1, 2, 7, 8, 9]], STANDING[[0, 1, 2, 7, 8, 9]])
    trajectory = Trajectory(STAMPS_S, jump(1.0))
    matched = associate(trajectory, truth)
    steps = tracked_steps(matched, STAMPS_S, np.zeros(COUNT, np.int64))
    assert (count_gross_errors(matched, steps), len(steps)) == (0, 4)
