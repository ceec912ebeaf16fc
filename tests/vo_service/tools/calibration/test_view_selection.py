"""Which snapshots become views."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.tools.calibration.rendered_boards import RenderedKinect
from vo_service.tools.calibration.chessboard import Chessboard
from vo_service.tools.calibration.snapshot import Snapshot, make_view
from vo_service.tools.calibration.view_selection import (
    ViewDecision,
    ViewSelector,
    estimate_board_pose,
)

FRAME_S = 1.0 / 30.0


def film(board: Chessboard, shifts_m: list[float]) -> list[Snapshot]:
    """Thirty frames a second of a board that stands a little further right each time."""
    kinect = RenderedKinect()
    poses = [rigid_transform(np.eye(3), [x - 0.17, -0.12, 0.7]) for x in shifts_m]
    taken = [kinect.take_snapshot(board, T, seed) for seed, T in enumerate(poses)]
    return [replace(each, stamp_s=n * FRAME_S) for n, each in enumerate(taken)]


def verdicts(board: Chessboard, frames: list[Snapshot]) -> list[ViewDecision]:
    picker = ViewSelector(board)
    return [picker.process(frame) for frame in frames]


@pytest.mark.slow
def test_in_a_film_a_view_is_taken_once_the_board_is_still(board: Chessboard) -> None:
    found = verdicts(board, film(board, [0.0, 0.01, 0.02, 0.02]))
    # The first frame could be the only one: a photograph.
    assert found[1:] == [ViewDecision.MOVING, ViewDecision.MOVING, ViewDecision.DUPLICATE]
    far = verdicts(board, film(board, [0.0, 0.05, 0.1, 0.1]))
    assert far == [
        ViewDecision.ACCEPTED,
        ViewDecision.MOVING,
        ViewDecision.MOVING,
        ViewDecision.ACCEPTED,
    ]


def test_a_board_that_has_just_come_into_view_may_still_move(board: Chessboard) -> None:
    before, after = film(board, [0.0, 0.0])
    empty = replace(before, color_bgr=np.full_like(before.color_bgr, 128))
    assert verdicts(board, [empty, after]) == [ViewDecision.NO_BOARD, ViewDecision.MOVING]


def test_photographs_need_not_show_the_same_twice(board: Chessboard) -> None:
    frames = [replace(f, stamp_s=30 * f.stamp_s) for f in film(board, [0.0, 0.15, 0.15])]
    assert verdicts(board, frames) == [
        ViewDecision.ACCEPTED,
        ViewDecision.ACCEPTED,
        ViewDecision.DUPLICATE,
    ]


@pytest.mark.parametrize("turn", [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, -0.3, 0.0]])
def test_a_tilt_makes_a_new_view(board: Chessboard, turn: list[float]) -> None:
    R, middle_m = so3_exp(turn), np.array([0.175, 0.1225, 0.0])
    kinect, picker = RenderedKinect(), ViewSelector(board)
    for seed, rotation in enumerate((np.eye(3), R)):
        T = rigid_transform(rotation, np.array([0.0, 0.0, 0.8]) - rotation @ middle_m)
        assert picker.process(kinect.take_snapshot(board, T, seed)) is ViewDecision.ACCEPTED


def test_a_stance_is_near_the_truth_before_the_lens_is_known(board: Chessboard) -> None:
    R = so3_exp([0.0, 0.5, 0.0])
    T = rigid_transform(R, np.array([0.0, 0.0, 0.9]) - R @ [0.175, 0.1225, 0.0])
    snapshot = RenderedKinect().take_snapshot(board, T, 0)
    found = estimate_board_pose(make_view(snapshot, board.find_corners(snapshot.gray)))
    assert found.distance_m == pytest.approx(0.9, rel=0.1)
    np.testing.assert_allclose(found.normal, -R[:, 2], atol=0.1)
    np.testing.assert_allclose(found.center, [0.5, 0.52], atol=0.05)
