"""Distances of points from the exact surfaces of a virtual room."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, transform_points
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motion.factory import make_motion
from drivers.synthetic.renderer import CLEARANCE_CHECKS_PER_S
from drivers.synthetic.room import ROOM_HEIGHT_M, build_room
from drivers.synthetic.solids import Solid, SolidKind

GOOD_DISTANCE_M = 0.015


@dataclass(frozen=True)
class SurfaceError:
    """Distances of a map's vertices from the true surface.

    `median_m`, `p90_m` and `p99_m` are percentiles of the distance. `within_15mm` is the fraction
    of the vertices within that distance.
    """

    vertices: int
    median_m: float
    p90_m: float
    p99_m: float
    within_15mm: float

    @classmethod
    def from_vertices(cls, vertices_m: Array, solids: Sequence[Solid]) -> "SurfaceError":
        """Compute the errors of vertices (N, 3) in the room."""
        off_m = distances_m(vertices_m, solids)
        return cls(
            vertices=len(off_m),
            median_m=float(np.median(off_m)),
            p90_m=float(np.percentile(off_m, 90)),
            p99_m=float(np.percentile(off_m, 99)),
            within_15mm=float(np.mean(off_m <= GOOD_DISTANCE_M)),
        )


def make_solids(config: SyntheticConfig) -> Sequence[Solid]:
    """Make the solids of the room of a configuration."""
    path = make_motion(config, ROOM_HEIGHT_M)
    checks = max(2, int(config.duration_s * CLEARANCE_CHECKS_PER_S))
    free_m = path.clearance_points_m(np.linspace(0.0, config.duration_s, checks))
    return build_room(config.seed, free_m, config.bare_wall, config.twin_corners)


def distances_m(points_m: Array, solids: Sequence[Solid]) -> Array:
    """Distances (N,) from points (N, 3) in the room to the nearest surface of any solid."""
    nearest_m = np.full(len(points_m), np.inf)
    for solid in solids:
        local_m = transform_points(inverse(solid.T_world_solid), points_m)
        # Only points that may be nearer than the best distance so far are computed.
        outside_m = np.linalg.norm(np.maximum(np.abs(local_m) - solid.half_m, 0.0), axis=1)
        near = np.flatnonzero(outside_m < nearest_m)
        nearest_m[near] = np.minimum(nearest_m[near], _distance_m(local_m[near], solid))
    return nearest_m


def _distance_m(local_m: Array, solid: Solid) -> Array:
    """Distances (N,) of points in the solid's frame to its surface; to first order for a sphere."""
    half_m = solid.half_m
    distance_m: Array
    if solid.kind is SolidKind.CYLINDER:  # width equals depth, and the ends are open
        across_m = np.hypot(local_m[:, 0], local_m[:, 1]) - half_m[0]
        distance_m = np.hypot(across_m, np.maximum(np.abs(local_m[:, 2]) - half_m[2], 0.0))
    elif solid.kind is SolidKind.SPHERE:
        unit = np.linalg.norm(local_m / half_m, axis=1)
        slope = np.linalg.norm(local_m / half_m**2, axis=1)
        distance_m = np.abs(unit * (unit - 1.0) / np.maximum(slope, 1e-9))
    else:
        beyond_m = np.abs(local_m) - half_m
        outside_m = np.linalg.norm(np.maximum(beyond_m, 0.0), axis=1)
        distance_m = np.abs(outside_m + np.minimum(beyond_m.max(axis=1), 0.0))
    return distance_m
