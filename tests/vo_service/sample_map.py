"""A map of places that nobody has seen."""

from dataclasses import replace
from typing import Any

import numpy as np

from drivers.core.geometry import rigid_transform, so3_exp
from vo_service.types.map_snapshot import MapSnapshot
from vo_service.types.odometry import Odometry


def make_map(keyframes: int = 4, **changes: Any) -> MapSnapshot:
    """A walk forward in steps of half a metre, whose last place is the first known again.

    It is of epoch 1. `odom` has drifted by 10 cm to the left and a tenth of a radian.
    """
    steps = [rigid_transform(np.eye(3), [0.5 * step, 0.0, 0.0]) for step in range(keyframes)]
    motions = [(step, step + 1) for step in range(keyframes - 1)]
    the_map = MapSnapshot(
        T_map_odom=rigid_transform(so3_exp([0.0, 0.0, 0.1]), [0.0, 0.1, 0.0]),
        T_map_keyframe=np.array(steps).reshape(-1, 4, 4),
        edges=np.array([*motions, (0, keyframes - 1)], np.int32),
        is_loop_closure=np.array([*[False] * len(motions), True]),
        epoch=1,
    )
    return replace(the_map, **changes)


class FixedLoopClosure:
    """A map that does not change."""

    def __init__(self, snapshot: MapSnapshot) -> None:
        self.snapshot = snapshot

    def wrap(self, odometry: Odometry) -> Odometry:
        """As it is."""
        return odometry
