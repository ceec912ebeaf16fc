"""Gaps in the coverage of the views, with instructions to fill them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from vo_service.tools.calibration.snapshot import BoardView
from vo_service.tools.calibration.view_selection import BoardPose, ViewDecision, ViewSelector

# Distortion is known only where corners were seen. The image has three by three zones with narrow
# outer ones.
ZONES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)
ZONE_EDGES = (0.25, 0.75)
MIN_ZONE_CORNERS = 6
# Sine of a tilt of 20 degrees, and the number of views with this tilt in each direction.
MIN_TILT_SIN = 0.34
MIN_TILTED_VIEWS = 2
# Minimum ratio of the largest to the smallest distance, to separate scale and offset.
MIN_DISTANCE_RATIO = 1.5

EDGE_TILTS: dict[str, Callable[[Array], float]] = {
    "left": lambda normal: float(normal[0]),
    "right": lambda normal: -float(normal[0]),
    "top": lambda normal: float(normal[1]),
    "bottom": lambda normal: -float(normal[1]),
}


@dataclass(frozen=True)
class CoverageGap:
    """Gap in the coverage, and how to fill it."""

    problem: str
    remedy: str


def count_zone_corners(views: Sequence[BoardView]) -> Array:
    """Return the number of corners (3, 3) in each zone of the image."""
    counts = np.zeros((3, 3))
    for view in views:
        column, row = np.digitize(view.corners.pixels / view.size, ZONE_EDGES).T
        np.add.at(counts, (row, column), 1)
    return counts


def find_coverage_gaps(
    views: Sequence[BoardView], board_poses: Sequence[BoardPose], with_depth: bool
) -> list[CoverageGap]:
    """Return the gaps in order of importance."""
    gaps = [*_tilt_gaps(board_poses), *_zone_gaps(views)]
    return [*gaps, *_distance_gaps(board_poses)] if with_depth else gaps


def _zone_gaps(views: Sequence[BoardView]) -> list[CoverageGap]:
    counts = count_zone_corners(views)
    empty = [ZONES[row][column] for row, column in np.argwhere(counts < MIN_ZONE_CORNERS)]
    return [
        CoverageGap(f"no corners at the {zone} of the image", f"show it at the {zone} of the image")
        for zone in empty
    ]


def _tilt_gaps(board_poses: Sequence[BoardPose]) -> list[CoverageGap]:
    return [
        CoverageGap(
            f"too few views with the board's {edge} edge tilted towards the camera",
            f"tilt its {edge} edge 20 to 45 degrees towards the camera",
        )
        for edge, tilt in EDGE_TILTS.items()
        if sum(tilt(pose.normal) > MIN_TILT_SIN for pose in board_poses) < MIN_TILTED_VIEWS
    ]


def _distance_gaps(board_poses: Sequence[BoardPose]) -> list[CoverageGap]:
    distances_m = [pose.distance_m for pose in board_poses] or [1.0]
    if max(distances_m) > MIN_DISTANCE_RATIO * min(distances_m):
        return []
    return [
        CoverageGap(
            f"all views are {min(distances_m):.1f} to {max(distances_m):.1f} m away",
            "hold it nearer (0.6 m) and farther (1.5 m)",
        )
    ]


class CoverageGuide:
    """Guide of the user: gives instructions until the views are complete."""

    def __init__(self, selector: ViewSelector, view_count: int, with_depth: bool) -> None:
        self._selector = selector
        self._view_count = view_count
        self._with_depth = with_depth

    @property
    def gaps(self) -> list[CoverageGap]:
        """Gaps of the views so far."""
        return find_coverage_gaps(
            self._selector.views, self._selector.board_poses, self._with_depth
        )

    @property
    def is_complete(self) -> bool:
        """Whether there are enough views without gaps."""
        return len(self._selector.views) >= self._view_count and not self.gaps

    def instruction(self, decision: ViewDecision) -> str:
        """Return one line after a snapshot: "12 of 25 views; show it at the top right"."""
        count = len(self._selector.views)
        views = (
            f"{count} of {self._view_count} views" if count < self._view_count else f"{count} views"
        )
        note = "" if decision is ViewDecision.ACCEPTED else f" [{decision}]"
        if self.is_complete:
            return f"{views}: enough"
        return f"{views}; {_next_remedy(self.gaps)}{note}"


def _next_remedy(gaps: Sequence[CoverageGap]) -> str:
    """Return the next instruction."""
    return gaps[0].remedy if gaps else "continue, each view a little different"
