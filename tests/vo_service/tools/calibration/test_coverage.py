"""Gaps in the coverage of the views, and the instructions for the user."""

from dataclasses import replace

import numpy as np

from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.coverage import CoverageGuide, find_coverage_gaps
from vo_service.tools.calibration.snapshot import NO_DEPTH, BoardView
from vo_service.tools.calibration.view_selection import BoardPose, ViewDecision, ViewSelector


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


def test_a_zone_without_corners_is_named() -> None:
    views = [view for view in VIEWS_EVERYWHERE if view.corners.pixels[0].tolist() != [600, 50]]
    (gap,) = find_coverage_gaps(views, POSES_WITH_ALL_TILTS, with_depth=True)
    assert gap.remedy == "show it at the top right of the image"


def test_a_missing_tilt_is_named_by_the_nearer_edge() -> None:
    # If the board is turned to the right, its left edge is nearer.
    turned_right = [s for s in POSES_WITH_ALL_TILTS if s.normal[0] <= 0]
    (gap,) = find_coverage_gaps(VIEWS_EVERYWHERE, turned_right, with_depth=False)
    assert gap.remedy == "tilt its left edge 20 to 45 degrees towards the camera"


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
