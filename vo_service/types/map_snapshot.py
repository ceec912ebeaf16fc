"""The map of places as it is at one moment: what goes out of it, and what a viewer draws."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """Nothing in it ever changes: another map is another object.

    T_map_odom      4x4, how `odom` lies in the map: what the places that are known again say
    epoch           of the poses that this is for: a `reset` lays `odom` elsewhere at once, and the
                    map knows of it some frames later
    T_map_place     (N, 4, 4) optical camera at each place, in REP 103 axes of the map; the newest
                    is the last
    edges           (M, 2) int32, rows of `T_map_keyframe` that are joined
    is_loop         (M,) bool: joined because a place was known again, not by the odometry
    is_localized      False where a map was loaded, or there was a loss, and no place of the map has
                    been known again since: `odom` then lies anywhere
    """

    T_map_odom: Array = field(default_factory=lambda: np.eye(4))
    T_map_keyframe: Array = field(default_factory=lambda: np.empty((0, 4, 4)))
    edges: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), np.int32))
    is_loop_closure: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    is_localized: bool = True
    epoch: int = 0

    @property
    def keyframes(self) -> int:
        """How many there are."""
        return len(self.T_map_keyframe)

    @property
    def loop_closures(self) -> int:
        """How often a place was known again."""
        return int(np.count_nonzero(self.is_loop_closure))


NO_MAP = MapSnapshot()
