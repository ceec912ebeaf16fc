"""Views are selected, and gaps in their coverage are found."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.tools.calibration.board_snapshots import BOARD
from tests.vo_service.tools.calibration.rendered_boards import RenderedKinect
from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.snapshot import NO_DEPTH, BoardView, Snapshot
from vo_service.tools.calibration.view_selection import (
    BoardPose,
    CoverageGuide,
    ViewDecision,
    ViewSelector,
    estimate_board_pose,
    find_coverage_gaps,
)

FRAME_S = 1.0 / 30.0


def render_video(shifts_m: list[float]) -> list[Snapshot]:
    """Render 30 frames a second of a BOARD at these positions."""
    kinect = RenderedKinect()
    poses = [rigid_transform(np.eye(3), [x - 0.17, -0.12, 0.7]) for x in shifts_m]
    snapshots = [kinect.take_snapshot(BOARD, T, seed) for seed, T in enumerate(poses)]
    return [replace(snapshot, stamp_s=n * FRAME_S) for n, snapshot in enumerate(snapshots)]


def decisions_on(frames: list[Snapshot]) -> list[ViewDecision]:
    selector = ViewSelector(BOARD)
    return [selector.process(frame) for frame in frames]


@pytest.mark.slow
def test_in_a_video_a_view_is_accepted_when_the_board_is_still() -> None:
    decisions = decisions_on(render_video([0.0, 0.01, 0.02, 0.02]))
    # The first frame could be a single photograph.
    assert decisions[1:] == [ViewDecision.MOVING, ViewDecision.MOVING, ViewDecision.DUPLICATE]
    distant = decisions_on(render_video([0.0, 0.05, 0.1, 0.1]))
    assert distant == [
        ViewDecision.ACCEPTED,
        ViewDecision.MOVING,
        ViewDecision.MOVING,
        ViewDecision.ACCEPTED,
    ]


def test_a_board_that_has_just_appeared_may_move() -> None:
    before, after = render_video([0.0, 0.0])
    empty = replace(before, color_bgr=np.full_like(before.color_bgr, 128))
    assert decisions_on([empty, after]) == [ViewDecision.NO_BOARD, ViewDecision.MOVING]


def test_photographs_need_no_still_board() -> None:
    frames = [replace(f, stamp_s=30 * f.stamp_s) for f in render_video([0.0, 0.15, 0.15])]
    assert decisions_on(frames) == [
        ViewDecision.ACCEPTED,
        ViewDecision.ACCEPTED,
        ViewDecision.DUPLICATE,
    ]


@pytest.mark.parametrize("rotation_vector", [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, -0.3, 0.0]])
def test_a_tilt_makes_a_new_view(rotation_vector: list[float]) -> None:
    R, center_m = so3_exp(rotation_vector), np.array([0.175, 0.1225, 0.0])
    kinect, selector = RenderedKinect(), ViewSelector(BOARD)
    for seed, rotation in enumerate((np.eye(3), R)):
        T = rigid_transform(rotation, np.array([0.0, 0.0, 0.8]) - rotation @ center_m)
        assert selector.process(kinect.take_snapshot(BOARD, T, seed)) is ViewDecision.ACCEPTED


def test_an_approximate_pose_is_near_the_truth() -> None:
    R = so3_exp([0.0, 0.5, 0.0])
    T = rigid_transform(R, np.array([0.0, 0.0, 0.9]) - R @ [0.175, 0.1225, 0.0])
    snapshot = RenderedKinect().take_snapshot(BOARD, T, 0)
    corners = BOARD.find_corners(snapshot.gray)
    pose = estimate_board_pose(BoardView("view", snapshot.size, corners, NO_DEPTH))
    assert pose.distance_m == pytest.approx(0.9, rel=0.1)
    np.testing.assert_allclose(pose.normal, -R[:, 2], atol=0.1)
    np.testing.assert_allclose(pose.center, [0.5, 0.52], atol=0.05)


def view_at(column: float, row: float) -> BoardView:
    """Make a view with a few corners at one place of a 640x480 image."""
    pixels = np.tile([column, row], (10, 1))
    return BoardView("view", (640, 480), BoardCorners(pixels, np.zeros((10, 3))), NO_DEPTH)


def tilted_pose(x: float, y: float, distance_m: float = 1.0) -> BoardPose:
    return BoardPose(
        np.array([0.5, 0.5]), distance_m, np.array([x, y, -np.sqrt(1 - x * x - y * y)])
    )


VIEWS_EVERYWHERE = [view_at(c, r) for c in (50, 320, 600) for r in (50, 240, 450)]
POSES_WITH_ALL_TILTS = 2 * [
    tilted_pose(0.5, 0),
    tilted_pose(-0.5, 0),
    tilted_pose(0, 0.5),
    tilted_pose(0, -0.5, 2.0),
]


# If the board is turned to the right, its left edge is nearer.
@pytest.mark.parametrize(
    ("views", "poses", "remedy"),
    [
        (
            [v for v in VIEWS_EVERYWHERE if v.corners.pixels[0].tolist() != [600, 50]],
            POSES_WITH_ALL_TILTS,
            "show it at the top right of the image",
        ),
        (
            VIEWS_EVERYWHERE,
            [pose for pose in POSES_WITH_ALL_TILTS if pose.normal[0] <= 0],
            "tilt its left edge 20 to 45 degrees towards the camera",
        ),
    ],
    ids=["zone", "tilt"],
)
def test_a_zone_without_corners_and_a_missing_tilt_are_named(
    views: list[BoardView], poses: list[BoardPose], remedy: str
) -> None:
    (gap,) = find_coverage_gaps(views, poses, with_depth=True)
    assert gap.remedy == remedy


def test_depth_needs_more_than_one_distance() -> None:
    near = [replace(s, distance_m=1.0) for s in POSES_WITH_ALL_TILTS]
    assert find_coverage_gaps(VIEWS_EVERYWHERE, near, with_depth=False) == []
    (gap,) = find_coverage_gaps(VIEWS_EVERYWHERE, near, with_depth=True)
    assert "nearer" in gap.remedy


def test_the_guide_ends_with_enough_views_without_gaps(selector: ViewSelector) -> None:
    assert not CoverageGuide(selector, len(selector.views), True).gaps
    guide = CoverageGuide(selector, len(selector.views), True)
    assert guide.is_complete
    assert guide.instruction(ViewDecision.ACCEPTED) == f"{len(selector.views)} views: enough"
    assert not CoverageGuide(selector, len(selector.views) + 1, True).is_complete


def test_the_guide_gives_the_count_and_the_next_instruction(selector: ViewSelector) -> None:
    count = len(selector.views)
    text = CoverageGuide(selector, 40, True).instruction(ViewDecision.MOVING)
    assert text == f"{count} of 40 views; continue, each view a little different [hold it still]"
    first = CoverageGuide(ViewSelector(selector.board), 25, False).instruction(
        ViewDecision.ACCEPTED
    )
    assert first == "0 of 25 views; tilt its left edge 20 to 45 degrees towards the camera"
