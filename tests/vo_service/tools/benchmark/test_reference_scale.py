"""True distances between frames."""

import math

import numpy as np
import pytest

from drivers.core.trajectory import Trajectory
from tests.vo_service.tools.evaluation.sample_trajectories import moving_along_x
from vo_service.tools.benchmark.reference_scale import GroundTruthDistance

WALK = Trajectory(10.0 + np.array([0.0, 0.01, 0.02, 0.5]), moving_along_x([1.0, 1.1, 1.3, 9.0]))


@pytest.mark.parametrize(
    ("from_s", "to_s", "meters"),
    [(10.0, 10.02, 0.3), (10.02, 10.0, 0.3), (10.005, 10.015, 0.15), (10.0, 10.0, 0.0)],
)
def test_positions_are_interpolated_between_the_true_poses(
    from_s: float, to_s: float, meters: float
) -> None:
    assert GroundTruthDistance(WALK)(from_s, to_s) == pytest.approx(meters, abs=1e-9)


@pytest.mark.parametrize("to_s", [9.9, 10.2, 10.6])
def test_without_truth_the_distance_is_nan(to_s: float) -> None:
    assert math.isnan(GroundTruthDistance(WALK)(10.0, to_s))
