"""Which place of a map can best be spared: one that its neighbours tell as well."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array

# Two places are as near as the sum of the way between them and of the turn, in these units.
DISTANCE_SCALE_M, DISTANCE_SCALE_RAD = 0.3, np.radians(20.0)


def find_most_redundant(T_map_keyframe: Array, component: NDArray[np.int64]) -> int:
    """Row of the place that can best be spared: one that is near to others of its part.

    Of two that are nearest to each other it is the one that is nearer to a third. The first and
    the last row are never spared. Raises ValueError with fewer than three places.

    T_map_place  (N, 4, 4), in the order in which they were seen
    part         (N,) what of the map a place is connected with: elsewhere nothing is near
    """
    count = len(T_map_keyframe)
    if count < 3:
        raise ValueError("the first and the newest place are never spared")
    apart = _pairwise_distances(T_map_keyframe)
    apart[component[:, None] != component[None, :]] = np.inf
    np.fill_diagonal(apart, np.inf)
    two_nearest = np.partition(apart, 1, axis=1)[:, :2]
    return min(range(1, count - 1), key=lambda n: tuple(two_nearest[n]))


def _pairwise_distances(T: Array) -> Array:
    """(N, N) how far poses are from each other, in the units above."""
    at_m, squared_m2 = T[:, :3, 3], np.sum(T[:, :3, 3] ** 2, axis=1)
    way_m2 = squared_m2[:, None] + squared_m2 - 2.0 * at_m @ at_m.T
    rows = T[:, :3, :3].reshape(len(T), 9)
    cosine = np.clip((rows @ rows.T - 1.0) / 2.0, -1.0, 1.0)
    apart: Array = (
        np.sqrt(np.maximum(way_m2, 0.0)) / DISTANCE_SCALE_M + np.arccos(cosine) / DISTANCE_SCALE_RAD
    )
    return apart
