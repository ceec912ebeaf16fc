"""The trajectory that the viewer draws."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.bounded_trajectory import (
    MIN_POINT_DISTANCE_M,
    PATH_PERIOD_S,
    BoundedTrajectory,
    SampledPath,
)


@given(st.lists(st.tuples(st.floats(-9, 9), st.integers(0, 3)), max_size=200))
def test_a_trajectory_is_bounded_and_ends_at_the_camera(steps: list[tuple[float, int]]) -> None:
    trajectory = BoundedTrajectory(max_points=16)
    for x, epoch in steps:
        position = np.array([x, 0.0, 0.0])
        trajectory.add(position, epoch)
        assert 1 <= sum(map(len, trajectory.lines)) <= 16
        assert abs(trajectory.lines[-1][-1][0] - x) < MIN_POINT_DISTANCE_M


def test_a_path_is_returned_whole_but_seldom() -> None:
    path, returned = SampledPath(), []
    for k in range(90):
        points = path.add(k / 30, np.array([0.1 * k, 0.0, 0.0]))
        if points is not None:
            np.testing.assert_allclose(points[:, 0], 0.1 * np.arange(k + 1), rtol=1e-6)
            returned.append(k / 30)
    assert 3.0 / PATH_PERIOD_S <= len(returned) <= 1 + 3.0 / PATH_PERIOD_S


def test_a_path_that_rests_is_not_returned_again() -> None:
    path = SampledPath()
    assert path.add(0.0, np.zeros(3)) is not None
    assert path.add(9.0, np.zeros(3)) is None
    assert path.add(9.1, np.ones(3)) is not None
