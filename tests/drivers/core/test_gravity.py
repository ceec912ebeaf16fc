"""The accelerometer's axes against the camera's, and what may count as gravity."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import (
    Vector,
    accelerometer_from_gravity,
    gravity_from_accelerometer,
    is_gravity,
)

NUMBERS = st.floats(-20.0, 20.0)


@pytest.mark.parametrize(
    ("reading", "gravity"),
    [
        ((0.0, 9.81, 0.0), (0.0, 9.81, 0.0)),  # level
        ((0.0, 6.0, -7.8), (0.0, 6.0, 7.8)),  # looking down: down is ahead
        ((-3.5, 9.0, 0.0), (-3.5, 9.0, 0.0)),  # turned clockwise: down is to the left
    ],
)
def test_gravity_points_down_in_the_camera_frame(reading: Vector, gravity: Vector) -> None:
    assert gravity_from_accelerometer(reading) == gravity


@given(st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_the_axes_convert_back_exactly(vector: Vector) -> None:
    assert accelerometer_from_gravity(gravity_from_accelerometer(vector)) == vector


@pytest.mark.parametrize(
    ("vector", "answer"),
    [
        ((0.0, 9.81, 0.0), True),
        ((5.5, 5.5, -5.5), True),
        ((0.0, 10.7, 0.0), True),
        ((0.0, 10.9, 0.0), False),
        ((0.0, 8.7, 0.0), False),
        ((0.0, 0.0, 0.0), False),
    ],
)
def test_only_a_vector_about_as_long_as_gravity_is_gravity(vector: Vector, answer: bool) -> None:
    assert is_gravity(vector) is answer
