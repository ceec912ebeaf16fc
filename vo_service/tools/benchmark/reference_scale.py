"""How far the camera really went: the first scale of a method that has none of its own."""

import math

import numpy as np

from drivers.core.trajectory import Trajectory, has_match


class GroundTruthDistance:
    """Distances between the true places of two frames."""

    def __init__(self, truth: Trajectory) -> None:
        self._truth = truth

    def __call__(self, from_s: float, to_s: float) -> float:
        """Metres between the places at two stamps, each interpolated between its neighbours.

        NaN where no truth is within 20 ms of a stamp: motion capture has gaps.
        """
        stamps_s, truth = np.array([from_s, to_s]), self._truth
        if not has_match(stamps_s, truth.stamps_s).all():
            return math.nan
        positions_m = truth.T_world_camera[:, :3, 3]
        places_m = [np.interp(stamps_s, truth.stamps_s, axis_m) for axis_m in positions_m.T]
        return float(np.linalg.norm(np.diff(places_m, axis=1)))
