"""Relocalization after a loss, with a scripted odometry and relocalizer."""

from collections.abc import Iterable, Sequence

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, is_rigid, rigid_transform, so3_exp
from tests.vo_service import fakes
from vo_service.slam.relocalization import (
    MAX_SEARCH_FRAMES,
    RelocalizationResult,
    RelocalizingOdometry,
)
from vo_service.types.estimate import Estimate

STEP = rigid_transform(so3_exp([0.0, 0.02, 0.0]), [0.01, 0.0, 0.02])
ELSEWHERE = rigid_transform(so3_exp([0.0, 1.0, 0.0]), [0.3, 0.0, 0.2])
TRUTH = [np.linalg.matrix_power(STEP, n) for n in range(100)]
LOST_AT = 5
SURE, RESULT_COVARIANCE = np.eye(6) * 1e-6, np.eye(6) * 1e-4


class WalkingOdometry:
    """Odometry that moves by STEP and is reset at the frames in `resets`.

    Every third frame is the next reference.
    """

    def __init__(self, *resets: int) -> None:
        self._resets = resets
        self._T_world_camera = np.eye(4)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        restarted = frame.seq in self._resets
        if frame.seq and not restarted:
            self._T_world_camera = self._T_world_camera @ STEP
        return Estimate(
            True, "", self._T_world_camera, STEP, SURE,
            is_reset=restarted, is_next_reference=frame.seq % 3 == 0,
        )  # fmt: skip


class ScriptedRelocalizer:
    """Relocalizer with scripted results.

    Args:
        errors: 4x4 errors by frame number.
        has_map: Whether it has a map.
        T_world_true: 4x4 true pose of the first frame.
    """

    def __init__(
        self,
        errors: dict[int, Array] | None = None,
        has_map: bool = True,
        T_world_true: Array = ELSEWHERE,
    ) -> None:
        self.has_map = has_map
        self.queried: list[int] = []
        self._errors = errors or {}
        self._T_world_true = T_world_true
        self._answers: list[RelocalizationResult] = []

    def query(self, frame: RgbdFrame) -> None:
        T = self._T_world_true @ TRUTH[frame.seq] @ self._errors.get(frame.seq, np.eye(4))
        self.queried.append(frame.seq)
        self._answers.append(RelocalizationResult(frame.seq, T, RESULT_COVARIANCE))

    def poll_results(self) -> Sequence[RelocalizationResult]:
        answers, self._answers = self._answers, []
        return answers


class FailingRelocalizer(ScriptedRelocalizer):
    """Relocalizer that recognizes no frame."""

    def poll_results(self) -> Sequence[RelocalizationResult]:
        return []


class WrongRelocalizer(FailingRelocalizer):
    """Relocalizer with results that were not requested."""

    def poll_results(self) -> Sequence[RelocalizationResult]:
        return [RelocalizationResult(seq, ELSEWHERE, RESULT_COVARIANCE) for seq in (998, 999)]


class DelayedRelocalizer(ScriptedRelocalizer):
    """Relocalizer whose results come late."""

    def poll_results(self) -> Sequence[RelocalizationResult]:
        return super().poll_results() if self.queried[-1] >= 20 else []


def walk(
    relocalizer: ScriptedRelocalizer, *resets: int, frames: Iterable[int] = range(60)
) -> list[Estimate]:
    odometry = RelocalizingOdometry(WalkingOdometry(*resets), relocalizer)
    return [odometry.estimate(fakes.make_frame(seq)) for seq in frames]


def epochs_begin(estimates: Sequence[Estimate]) -> list[int]:
    return [seq for seq, estimate in enumerate(estimates) if estimate.is_reset]


def first_back(estimates: Sequence[Estimate]) -> int:
    """The first good frame after the loss."""
    return next(seq for seq, each in enumerate(estimates) if seq >= LOST_AT and each.ok)


def test_without_a_loss_nothing_changes() -> None:
    plain = WalkingOdometry()
    for seq, estimate in enumerate(walk(ScriptedRelocalizer(), frames=range(10))):
        assert np.array_equal(
            estimate.T_world_camera, plain.estimate(fakes.make_frame(seq)).T_world_camera
        )


def test_camera_at_a_known_place_is_relocalized_in_its_world_and_epoch() -> None:
    estimates = walk(ScriptedRelocalizer(), LOST_AT)
    assert not any(estimate.is_reset for estimate in estimates)
    back = [seq for seq, estimate in enumerate(estimates) if seq >= LOST_AT and estimate.ok]
    assert back[0] <= LOST_AT + 6
    for seq in back:
        expected = ELSEWHERE @ TRUTH[seq]
        assert np.allclose(estimates[seq].T_world_camera, expected, atol=1e-9)


def test_pose_is_lost_until_two_results_agree() -> None:
    estimates = walk(ScriptedRelocalizer(), LOST_AT)
    held = estimates[LOST_AT - 1].T_world_camera
    assert not estimates[LOST_AT].ok
    assert "relocalizing" in estimates[LOST_AT].reason
    assert np.array_equal(estimates[LOST_AT].T_world_camera, held)
    assert not estimates[LOST_AT].covariance.any()


@pytest.mark.parametrize("wrong", [LOST_AT, LOST_AT + 3])
@pytest.mark.parametrize(("off_m", "off_rad"), [(0.2, 0.0), (0.0, 0.2)])
def test_one_wrong_result_is_rejected(wrong: int, off_m: float, off_rad: float) -> None:
    off = rigid_transform(so3_exp([0.0, 0.0, off_rad]), [off_m, 0.0, 0.0])
    estimates = walk(ScriptedRelocalizer({wrong: off}), LOST_AT)
    back = first_back(estimates)
    assert back == LOST_AT + 6
    for seq in range(back, len(estimates)):
        assert np.allclose(estimates[seq].T_world_camera, ELSEWHERE @ TRUTH[seq], atol=1e-9)


def test_first_relocalized_pose_has_the_covariance_of_the_result() -> None:
    estimates = walk(ScriptedRelocalizer(), LOST_AT)
    back = first_back(estimates)
    assert np.array_equal(estimates[back].covariance, RESULT_COVARIANCE)
    assert np.array_equal(estimates[back + 1].covariance, SURE)


def test_poses_stay_rigid_despite_rounded_results() -> None:
    rounded = dict.fromkeys(range(60), np.diag([1.0 + 1e-5, 1.0, 1.0, 1.0]))
    estimates = walk(ScriptedRelocalizer(rounded), LOST_AT)
    assert first_back(estimates) == LOST_AT + 3
    assert all(is_rigid(estimate.T_world_camera, tolerance=1e-9) for estimate in estimates)


def test_unreachable_place_is_rejected() -> None:
    far = rigid_transform(np.eye(3), [1.5, 0.0, 0.0])
    estimates = walk(ScriptedRelocalizer(T_world_true=far), LOST_AT, frames=range(30))
    assert not any(estimate.ok for estimate in estimates[LOST_AT:])


def test_camera_that_was_extrapolated_in_darkness_is_relocalized() -> None:
    far = rigid_transform(np.eye(3), [1.5, 0.0, 0.0])
    estimates = walk(
        ScriptedRelocalizer(T_world_true=far), 40, frames=[*range(LOST_AT), *range(40, 50)]
    )
    assert first_back(estimates) == LOST_AT + 3


def test_results_of_unknown_queries_are_ignored() -> None:
    estimates = walk(WrongRelocalizer(), LOST_AT)
    assert epochs_begin(estimates) == [LOST_AT + MAX_SEARCH_FRAMES - 1]


def test_results_from_before_another_reset_are_ignored() -> None:
    # Frames 5, 8 and 11 are queried; their results come when the camera is elsewhere.
    frames = [*range(12), *range(30, 60)]
    estimates = walk(DelayedRelocalizer(), LOST_AT, 30, frames=frames)
    back = first_back(estimates)
    assert frames[back] >= 30 + 3
    assert np.allclose(estimates[back].T_world_camera, ELSEWHERE @ TRUTH[frames[back]], atol=1e-9)


def test_unseen_place_starts_an_epoch_after_a_second() -> None:
    blind = FailingRelocalizer()
    estimates = walk(blind, LOST_AT)
    (begin,) = epochs_begin(estimates)
    assert begin == LOST_AT + MAX_SEARCH_FRAMES - 1
    assert all(estimate.ok for estimate in estimates[begin:])
    assert blind.queried == list(range(LOST_AT, begin, 3))


def test_without_a_map_an_epoch_starts_at_once() -> None:
    estimates = walk(ScriptedRelocalizer(has_map=False), LOST_AT)
    assert estimates[LOST_AT].is_reset
    assert estimates[LOST_AT].ok


def test_another_reset_does_not_extend_the_search() -> None:
    estimates = walk(FailingRelocalizer(), LOST_AT, LOST_AT + 10)
    assert epochs_begin(estimates) == [LOST_AT + MAX_SEARCH_FRAMES - 1]


def test_reported_motions_connect_each_reference_to_its_frame() -> None:
    estimates = walk(ScriptedRelocalizer(), LOST_AT)
    T_world_reference = np.eye(4)
    for estimate in estimates:
        if estimate.ok:
            T_world_camera = T_world_reference @ estimate.T_reference_camera
            assert np.allclose(T_world_camera, estimate.T_world_camera, atol=1e-9)
            if estimate.is_next_reference:
                T_world_reference = estimate.T_world_camera
