"""What views lack, and what whoever holds the board is told."""

from dataclasses import replace

import numpy as np

from vo_service.calibration.board import Corners
from vo_service.calibration.guidance import lacks
from vo_service.calibration.guide import Guide
from vo_service.calibration.picking import Stance, Verdict, ViewPicker
from vo_service.calibration.snapshot import NO_DEPTH, View


def view_at(column: float, row: float) -> View:
    """A few corners in one place of the image, 640x480."""
    pixels = np.tile([column, row], (10, 1))
    return View("view", (640, 480), Corners(pixels, np.zeros((10, 3))), NO_DEPTH)


def leaning(x: float, y: float, distance_m: float = 1.0) -> Stance:
    return Stance(np.array([0.5, 0.5]), distance_m, np.array([x, y, -np.sqrt(1 - x * x - y * y)]))


EVERYWHERE = [view_at(c, r) for c in (50, 320, 600) for r in (50, 240, 450)]
EVERY_WAY = 2 * [leaning(0.5, 0), leaning(-0.5, 0), leaning(0, 0.5), leaning(0, -0.5, 2.0)]


def test_a_zone_without_corners_is_named() -> None:
    without = [view for view in EVERYWHERE if view.corners.pixels[0].tolist() != [600, 50]]
    (lack,) = lacks(without, EVERY_WAY, with_depth=True)
    assert lack.remedy == "show it at the top right of the image"


def test_a_tilt_that_is_missing_is_named_by_the_edge_that_comes_nearer() -> None:
    # The board's face is turned to the right, so its left edge is the near one.
    turned_right = [s for s in EVERY_WAY if s.normal[0] <= 0]
    (lack,) = lacks(EVERYWHERE, turned_right, with_depth=False)
    assert lack.remedy == "tilt its left edge 20 to 45 degrees towards the camera"


def test_depth_needs_more_than_one_distance() -> None:
    near = [replace(s, distance_m=1.0) for s in EVERY_WAY]
    assert lacks(EVERYWHERE, near, with_depth=False) == []
    (lack,) = lacks(EVERYWHERE, near, with_depth=True)
    assert "nearer" in lack.remedy


def test_the_guide_ends_when_views_are_many_and_nothing_lacks(picker: ViewPicker) -> None:
    assert not Guide(picker, len(picker.views), True).lacks
    done = Guide(picker, len(picker.views), True)
    assert done.is_done
    assert done.text(Verdict.TAKEN) == f"{len(picker.views)} views: enough"
    assert not Guide(picker, len(picker.views) + 1, True).is_done


def test_the_guide_says_how_many_and_what_next(picker: ViewPicker) -> None:
    count = len(picker.views)
    text = Guide(picker, 40, True).text(Verdict.MOVING)
    assert text == f"{count} of 40 views; go on, each time a little different [hold it still]"
    first = Guide(ViewPicker(picker.board), 25, False).text(Verdict.TAKEN)
    assert first == "0 of 25 views; tilt its left edge 20 to 45 degrees towards the camera"
