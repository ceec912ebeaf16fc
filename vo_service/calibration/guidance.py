"""What the views taken so far still lack, as something to do with the board."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array
from vo_service.calibration.picking import Stance
from vo_service.calibration.snapshot import View

# Distortion is only known where corners were seen: the image in three by three zones, of which
# the outer ones are narrow.
ZONES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)
ZONE_EDGES = (0.25, 0.75)
ZONE_CORNERS = 6
# Sideways part of the board's normal at 20 degrees, and how many views lean so far each way.
LEANING = 0.34
LEANING_VIEWS = 2
# Farthest over nearest view: a scale can be told from an offset.
DEPTH_RANGE = 1.5

EDGES: dict[str, Callable[[Array], float]] = {
    "left": lambda normal: float(normal[0]),
    "right": lambda normal: -float(normal[0]),
    "top": lambda normal: float(normal[1]),
    "bottom": lambda normal: -float(normal[1]),
}


@dataclass(frozen=True)
class Lack:
    """Something that no view shows, and what to do about it."""

    what: str
    remedy: str


def zone_corners(views: Sequence[View]) -> Array:
    """(3, 3) how many corners lie in each zone of the image."""
    counts = np.zeros((3, 3))
    for view in views:
        column, row = np.digitize(view.corners.pixels / view.size, ZONE_EDGES).T
        np.add.at(counts, (row, column), 1)
    return counts


def lacks(views: Sequence[View], stances: Sequence[Stance], with_depth: bool) -> list[Lack]:
    """What is missing, the most important first."""
    found = [*_tilts(stances), *_zones(views)]
    return [*found, *_distances(stances)] if with_depth else found


def _zones(views: Sequence[View]) -> list[Lack]:
    counts = zone_corners(views)
    empty = [ZONES[row][column] for row, column in np.argwhere(counts < ZONE_CORNERS)]
    return [
        Lack(f"no corners at the {zone} of the image", f"show it at the {zone} of the image")
        for zone in empty
    ]


def _tilts(stances: Sequence[Stance]) -> list[Lack]:
    return [
        Lack(
            f"too few views with the board's {edge} edge tilted towards the camera",
            f"tilt its {edge} edge 20 to 45 degrees towards the camera",
        )
        for edge, lean in EDGES.items()
        if sum(lean(stance.normal) > LEANING for stance in stances) < LEANING_VIEWS
    ]


def _distances(stances: Sequence[Stance]) -> list[Lack]:
    distances_m = [stance.distance_m for stance in stances] or [1.0]
    if max(distances_m) > DEPTH_RANGE * min(distances_m):
        return []
    return [
        Lack(
            f"all views are {min(distances_m):.1f} to {max(distances_m):.1f} m away",
            "hold it nearer (0.6 m) and farther (1.5 m)",
        )
    ]
