"""True distances, for the first scale of a method without metric scale."""

import math

import numpy as np

from drivers.core.trajectory import Trajectory, has_match


class GroundTruthDistance:
    """Distances between the true positions of two frames."""

    def __init__(self, truth: Trajectory) -> None:
        self._truth = truth

    def __call__(self, from_s: float, to_s: float) -> float:
        """Return the distance between the interpolated positions at two stamps, m.

        NaN if no truth is within 20 ms of a stamp, because motion capture has gaps.
        """
        stamps_s, truth = np.array([from_s, to_s]), self._truth
        if not has_match(stamps_s, truth.stamps_s).all():
            return math.nan
        positions_m = truth.T_world_camera[:, :3, 3]
        interpolated_m = [np.interp(stamps_s, truth.stamps_s, axis_m) for axis_m in positions_m.T]
        return float(np.linalg.norm(np.diff(interpolated_m, axis=1)))
