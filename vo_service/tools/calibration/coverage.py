"""What the views taken so far still lack, as something to do with the board."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from vo_service.tools.calibration.snapshot import BoardView
from vo_service.tools.calibration.view_selection import BoardPose, ViewDecision, ViewSelector

# Distortion is only known where corners were seen: the image in three by three zones, of which
# the outer ones are narrow.
ZONES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)
ZONE_EDGES = (0.25, 0.75)
MIN_ZONE_CORNERS = 6
# Sideways part of the board's normal at 20 degrees, and how many views lean so far each way.
MIN_TILT_SIN = 0.34
MIN_TILTED_VIEWS = 2
# Farthest over nearest view: a scale can be told from an offset.
MIN_DISTANCE_RATIO = 1.5

EDGE_TILTS: dict[str, Callable[[Array], float]] = {
    "left": lambda normal: float(normal[0]),
    "right": lambda normal: -float(normal[0]),
    "top": lambda normal: float(normal[1]),
    "bottom": lambda normal: -float(normal[1]),
}


@dataclass(frozen=True)
class CoverageGap:
    """Something that no view shows, and what to do about it."""

    problem: str
    remedy: str


def count_zone_corners(views: Sequence[BoardView]) -> Array:
    """(3, 3) how many corners lie in each zone of the image."""
    counts = np.zeros((3, 3))
    for view in views:
        column, row = np.digitize(view.corners.pixels / view.size, ZONE_EDGES).T
        np.add.at(counts, (row, column), 1)
    return counts


def find_coverage_gaps(
    views: Sequence[BoardView], board_poses: Sequence[BoardPose], with_depth: bool
) -> list[CoverageGap]:
    """What is missing, the most important first."""
    found = [*_tilt_gaps(board_poses), *_zone_gaps(views)]
    return [*found, *_distance_gaps(board_poses)] if with_depth else found


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
        for edge, lean in EDGE_TILTS.items()
        if sum(lean(stance.normal) > MIN_TILT_SIN for stance in board_poses) < MIN_TILTED_VIEWS
    ]


def _distance_gaps(board_poses: Sequence[BoardPose]) -> list[CoverageGap]:
    distances_m = [stance.distance_m for stance in board_poses] or [1.0]
    if max(distances_m) > MIN_DISTANCE_RATIO * min(distances_m):
        return []
    return [
        CoverageGap(
            f"all views are {min(distances_m):.1f} to {max(distances_m):.1f} m away",
            "hold it nearer (0.6 m) and farther (1.5 m)",
        )
    ]


class CoverageGuide:
    """Knows when the views are enough, and what to do until then."""

    def __init__(self, selector: ViewSelector, view_count: int, with_depth: bool) -> None:
        self._picker = selector
        self._wanted = view_count
        self._with_depth = with_depth

    @property
    def gaps(self) -> list[CoverageGap]:
        """What the views taken so far still lack."""
        return find_coverage_gaps(self._picker.views, self._picker.board_poses, self._with_depth)

    @property
    def is_complete(self) -> bool:
        """Views enough, and nothing lacking."""
        return len(self._picker.views) >= self._wanted and not self.gaps

    def instruction(self, decision: ViewDecision) -> str:
        """One line, after a snapshot was judged: "12 of 25 views; show it at the top right"."""
        count = len(self._picker.views)
        views = f"{count} of {self._wanted} views" if count < self._wanted else f"{count} views"
        now = "" if decision is ViewDecision.ACCEPTED else f" [{decision}]"
        if self.is_complete:
            return f"{views}: enough"
        return f"{views}; {_next_remedy(self.gaps)}{now}"


def _next_remedy(gaps: Sequence[CoverageGap]) -> str:
    """What to do now."""
    return gaps[0].remedy if gaps else "go on, each time a little different"
