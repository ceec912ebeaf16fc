"""The trajectory that the viewer draws."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.bounded_trajectory import MIN_POINT_DISTANCE_M, BoundedTrajectory


@given(st.lists(st.tuples(st.floats(-9, 9), st.integers(0, 3)), max_size=200))
def test_a_trajectory_is_bounded_and_ends_at_the_camera(steps: list[tuple[float, int]]) -> None:
    trajectory = BoundedTrajectory(max_points=16)
    for x, epoch in steps:
        position = np.array([x, 0.0, 0.0])
        trajectory.add(position, epoch)
        assert 1 <= sum(map(len, trajectory.lines)) <= 16
        assert abs(trajectory.lines[-1][-1][0] - x) < MIN_POINT_DISTANCE_M
