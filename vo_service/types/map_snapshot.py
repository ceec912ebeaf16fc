"""The pose graph at one time."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The pose graph at one time. Immutable: a changed map is a new object.

    Attributes:
        T_map_odom: 4x4 transform of `odom` in the map, from the loop closures.
        T_map_keyframe: (N, 4, 4) optical camera at each keyframe, in REP 103 axes of the map; the
            newest is the last.
        edges: (M, 2) int32, pairs of rows of `T_map_keyframe`.
        is_loop_closure: (M,) bool: whether the edge is a loop closure, not odometry.
        is_localized: Whether `T_map_odom` is known. False from the load of a map, or a loss, until
            relocalization in the map.
        epoch: Epoch of the poses that `T_map_odom` is valid for. After a `reset`, the map follows
            some frames later.
    """

    T_map_odom: Array = field(default_factory=lambda: np.eye(4))
    T_map_keyframe: Array = field(default_factory=lambda: np.empty((0, 4, 4)))
    edges: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), np.int32))
    is_loop_closure: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    is_localized: bool = True
    epoch: int = 0

    def is_localized_in(self, epoch: int) -> bool:
        """Whether the transform of an epoch's `odom` in the map is known; True without a map.

        A map from before the epoch does not have it.
        """
        return self is NO_MAP or (self.is_localized and self.epoch == epoch)

    @property
    def keyframes(self) -> int:
        """Number of keyframes."""
        return len(self.T_map_keyframe)

    @property
    def loop_closures(self) -> int:
        """Number of loop closures."""
        return int(np.count_nonzero(self.is_loop_closure))


NO_MAP = MapSnapshot()
