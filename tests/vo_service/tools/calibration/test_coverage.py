"""What views lack, and what whoever holds the board is told."""

from dataclasses import replace

import numpy as np

from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.coverage import CoverageGuide, find_coverage_gaps
from vo_service.tools.calibration.snapshot import NO_DEPTH, BoardView
from vo_service.tools.calibration.view_selection import BoardPose, ViewDecision, ViewSelector


def view_at(column: float, row: float) -> BoardView:
    """A few corners in one place of the image, 640x480."""
    pixels = np.tile([column, row], (10, 1))
    return BoardView("view", (640, 480), BoardCorners(pixels, np.zeros((10, 3))), NO_DEPTH)


def leaning(x: float, y: float, distance_m: float = 1.0) -> BoardPose:
    return BoardPose(
        np.array([0.5, 0.5]), distance_m, np.array([x, y, -np.sqrt(1 - x * x - y * y)])
    )


EVERYWHERE = [view_at(c, r) for c in (50, 320, 600) for r in (50, 240, 450)]
EVERY_WAY = 2 * [leaning(0.5, 0), leaning(-0.5, 0), leaning(0, 0.5), leaning(0, -0.5, 2.0)]


def test_a_zone_without_corners_is_named() -> None:
    without = [view for view in EVERYWHERE if view.corners.pixels[0].tolist() != [600, 50]]
    (lack,) = find_coverage_gaps(without, EVERY_WAY, with_depth=True)
    assert lack.remedy == "show it at the top right of the image"


def test_a_tilt_that_is_missing_is_named_by_the_edge_that_comes_nearer() -> None:
    # The board's face is turned to the right, so its left edge is the near one.
    turned_right = [s for s in EVERY_WAY if s.normal[0] <= 0]
    (lack,) = find_coverage_gaps(EVERYWHERE, turned_right, with_depth=False)
    assert lack.remedy == "tilt its left edge 20 to 45 degrees towards the camera"


def test_depth_needs_more_than_one_distance() -> None:
    near = [replace(s, distance_m=1.0) for s in EVERY_WAY]
    assert find_coverage_gaps(EVERYWHERE, near, with_depth=False) == []
    (lack,) = find_coverage_gaps(EVERYWHERE, near, with_depth=True)
    assert "nearer" in lack.remedy


def test_the_guide_ends_when_views_are_many_and_nothing_lacks(picker: ViewSelector) -> None:
    assert not CoverageGuide(picker, len(picker.views), True).gaps
    done = CoverageGuide(picker, len(picker.views), True)
    assert done.is_complete
    assert done.instruction(ViewDecision.ACCEPTED) == f"{len(picker.views)} views: enough"
    assert not CoverageGuide(picker, len(picker.views) + 1, True).is_complete


def test_the_guide_says_how_many_and_what_next(picker: ViewSelector) -> None:
    count = len(picker.views)
    text = CoverageGuide(picker, 40, True).instruction(ViewDecision.MOVING)
    assert text == f"{count} of 40 views; go on, each time a little different [hold it still]"
    first = CoverageGuide(ViewSelector(picker.board), 25, False).instruction(ViewDecision.ACCEPTED)
    assert first == "0 of 25 views; tilt its left edge 20 to 45 degrees towards the camera"
