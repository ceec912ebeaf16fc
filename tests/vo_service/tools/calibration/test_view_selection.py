"""Selection of views."""

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


def render_video(board: Chessboard, shifts_m: list[float]) -> list[Snapshot]:
    """Render 30 frames a second of a board at these positions."""
    kinect = RenderedKinect()
    poses = [rigid_transform(np.eye(3), [x - 0.17, -0.12, 0.7]) for x in shifts_m]
    snapshots = [kinect.take_snapshot(board, T, seed) for seed, T in enumerate(poses)]
    return [replace(snapshot, stamp_s=n * FRAME_S) for n, snapshot in enumerate(snapshots)]


def decisions_on(board: Chessboard, frames: list[Snapshot]) -> list[ViewDecision]:
    selector = ViewSelector(board)
    return [selector.process(frame) for frame in frames]


@pytest.mark.slow
def test_in_a_video_a_view_is_accepted_when_the_board_is_still(board: Chessboard) -> None:
    decisions = decisions_on(board, render_video(board, [0.0, 0.01, 0.02, 0.02]))
    # The first frame could be a single photograph.
    assert decisions[1:] == [ViewDecision.MOVING, ViewDecision.MOVING, ViewDecision.DUPLICATE]
    distant = decisions_on(board, render_video(board, [0.0, 0.05, 0.1, 0.1]))
    assert distant == [
        ViewDecision.ACCEPTED,
        ViewDecision.MOVING,
        ViewDecision.MOVING,
        ViewDecision.ACCEPTED,
    ]


def test_a_board_that_has_just_appeared_may_move(board: Chessboard) -> None:
    before, after = render_video(board, [0.0, 0.0])
    empty = replace(before, color_bgr=np.full_like(before.color_bgr, 128))
    assert decisions_on(board, [empty, after]) == [ViewDecision.NO_BOARD, ViewDecision.MOVING]


def test_photographs_need_no_still_board(board: Chessboard) -> None:
    frames = [replace(f, stamp_s=30 * f.stamp_s) for f in render_video(board, [0.0, 0.15, 0.15])]
    assert decisions_on(board, frames) == [
        ViewDecision.ACCEPTED,
        ViewDecision.ACCEPTED,
        ViewDecision.DUPLICATE,
    ]


@pytest.mark.parametrize("rotation_vector", [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, -0.3, 0.0]])
def test_a_tilt_makes_a_new_view(board: Chessboard, rotation_vector: list[float]) -> None:
    R, center_m = so3_exp(rotation_vector), np.array([0.175, 0.1225, 0.0])
    kinect, selector = RenderedKinect(), ViewSelector(board)
    for seed, rotation in enumerate((np.eye(3), R)):
        T = rigid_transform(rotation, np.array([0.0, 0.0, 0.8]) - rotation @ center_m)
        assert selector.process(kinect.take_snapshot(board, T, seed)) is ViewDecision.ACCEPTED


def test_an_approximate_pose_is_near_the_truth(board: Chessboard) -> None:
    R = so3_exp([0.0, 0.5, 0.0])
    T = rigid_transform(R, np.array([0.0, 0.0, 0.9]) - R @ [0.175, 0.1225, 0.0])
    snapshot = RenderedKinect().take_snapshot(board, T, 0)
    pose = estimate_board_pose(make_view(snapshot, board.find_corners(snapshot.gray)))
    assert pose.distance_m == pytest.approx(0.9, rel=0.1)
    np.testing.assert_allclose(pose.normal, -R[:, 2], atol=0.1)
    np.testing.assert_allclose(pose.center, [0.5, 0.52], atol=0.05)
