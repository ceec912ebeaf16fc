"""Coming back after a loss, with an odometry and a finder that do as they are told."""

from collections.abc import Sequence

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, rigid_transform, rotation_from_vector
from tests.vo_service import fakes
from vo_service.odometry.estimate import Estimate
from vo_service.odometry.relocalising import PATIENCE_FRAMES, Located, RelocalisingOdometry

STEP = rigid_transform(rotation_from_vector([0.0, 0.02, 0.0]), [0.01, 0.0, 0.02])
ELSEWHERE = rigid_transform(rotation_from_vector([0.0, 1.0, 0.0]), [0.3, 0.0, 0.2])
TRUTH = [np.linalg.matrix_power(STEP, n) for n in range(100)]
LOST_AT = 5


class Walker:
    """Walks on by STEP; begins anew, where it was, at the frames in `anew`."""

    def __init__(self, *anew: int) -> None:
        self._anew = anew
        self._T_world_camera = np.eye(4)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        restarted = frame.seq in self._anew
        if frame.seq and not restarted:
            self._T_world_camera = self._T_world_camera @ STEP
        return Estimate(True, "", self._T_world_camera, STEP, np.eye(6) * 1e-6, restarted=restarted)


class Finder:
    """Knows where each frame was taken; off by `errors` in the frames that have one."""

    def __init__(self, errors: dict[int, Array] | None = None, knows_places: bool = True) -> None:
        self.knows_places = knows_places
        self._errors = errors or {}
        self._answers: list[Located] = []

    def look(self, frame: RgbdFrame) -> None:
        T = ELSEWHERE @ TRUTH[frame.seq] @ self._errors.get(frame.seq, np.eye(4))
        self._answers.append(Located(frame.seq, T, np.eye(6) * 1e-4))

    def answers(self) -> Sequence[Located]:
        answers, self._answers = self._answers, []
        return answers


class Blind(Finder):
    """Knows places, but none of these."""

    def look(self, frame: RgbdFrame) -> None:
        pass


def walk(finder: Finder, *anew: int, frames: int = 60) -> list[Estimate]:
    odometry = RelocalisingOdometry(Walker(*anew), finder)
    return [odometry.estimate(fakes.frame(seq)) for seq in range(frames)]


def test_without_a_loss_nothing_is_changed() -> None:
    plain = Walker()
    for seq, estimate in enumerate(walk(Finder(), frames=10)):
        assert np.array_equal(
            estimate.T_world_camera, plain.estimate(fakes.frame(seq)).T_world_camera
        )


def test_camera_that_sees_a_known_place_is_back_in_its_world_and_epoch() -> None:
    estimates = walk(Finder(), LOST_AT)
    assert not any(estimate.restarted for estimate in estimates)
    back = [seq for seq, estimate in enumerate(estimates) if seq >= LOST_AT and estimate.ok]
    assert back[0] <= LOST_AT + 6
    for seq in back:
        expected = ELSEWHERE @ TRUTH[seq]
        assert np.allclose(estimates[seq].T_world_camera, expected, atol=1e-9)


def test_pose_is_held_and_lost_until_two_answers_agree() -> None:
    estimates = walk(Finder(), LOST_AT)
    held = estimates[LOST_AT - 1].T_world_camera
    assert not estimates[LOST_AT].ok
    assert "seen before" in estimates[LOST_AT].reason
    assert np.array_equal(estimates[LOST_AT].T_world_camera, held)


def test_one_wrong_answer_is_not_believed() -> None:
    far = rigid_transform(np.eye(3), [0.5, 0.0, 0.0])
    estimates = walk(Finder({LOST_AT: far}), LOST_AT)
    for seq, estimate in enumerate(estimates):
        if seq >= LOST_AT and estimate.ok:
            assert np.allclose(estimate.T_world_camera, ELSEWHERE @ TRUTH[seq], atol=1e-9)


def test_place_that_the_camera_cannot_have_reached_is_not_believed() -> None:
    far = {seq: rigid_transform(np.eye(3), [9.0, 0.0, 0.0]) for seq in range(60)}
    estimates = walk(Finder(far), LOST_AT)
    assert [seq for seq, estimate in enumerate(estimates) if estimate.restarted] == [
        LOST_AT + PATIENCE_FRAMES - 1
    ]


def test_place_never_seen_begins_an_epoch_after_a_second() -> None:
    estimates = walk(Blind(), LOST_AT)
    restarted = [seq for seq, estimate in enumerate(estimates) if estimate.restarted]
    assert restarted == [LOST_AT + PATIENCE_FRAMES - 1]
    assert all(estimate.ok for estimate in estimates[restarted[0] :])


def test_without_any_place_an_epoch_begins_at_once() -> None:
    estimates = walk(Finder(knows_places=False), LOST_AT)
    assert estimates[LOST_AT].restarted
    assert estimates[LOST_AT].ok


def test_beginning_anew_once_more_forgets_the_answers_and_keeps_the_patience() -> None:
    estimates = walk(Blind(), LOST_AT, LOST_AT + 10)
    restarted = [seq for seq, estimate in enumerate(estimates) if estimate.restarted]
    assert restarted == [LOST_AT + PATIENCE_FRAMES - 1]


def test_motions_told_lead_from_each_reference_to_its_frame() -> None:
    estimates = walk(Finder(), LOST_AT)
    T_world_reference = np.eye(4)
    for estimate in estimates:
        if estimate.ok:
            told = T_world_reference @ estimate.T_reference_camera
            assert np.allclose(told, estimate.T_world_camera, atol=1e-9)
            T_world_reference = estimate.T_world_camera
