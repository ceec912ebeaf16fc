import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, rigid_transform, rotation_angle_rad, so3_exp
from tests.vo_service.odometry.hand_held_sequence import assert_close
from vo_service.odometry.motion_model import (
    MAX_SPEED_M_S,
    MAX_TURN_RATE_RAD_S,
    ConstantVelocityModel,
)

RATE_HZ = 30.0


def step(turn_rad_s: list[float], speed_m_s: list[float], duration_s: float = 1 / RATE_HZ) -> Array:
    """Motion in a straight line, seen from the camera before it, while turning about one axis."""
    R = so3_exp(np.array(turn_rad_s) * duration_s)
    return rigid_transform(R, np.array(speed_m_s) * duration_s)


def moved(motion: Array, frames: int) -> ConstantVelocityModel:
    model = ConstantVelocityModel()
    model.reset(0.0)
    for k in range(1, frames + 1):
        model.add(motion, k / RATE_HZ)
    return model


@pytest.mark.parametrize("ahead", [1, 3])
def test_a_constant_velocity_is_extrapolated(ahead: int) -> None:
    motion = step([0.0, 0.6, 0.1], [0.2, 0.0, 0.5])
    prediction = moved(motion, 5).predict((5 + ahead) / RATE_HZ)
    assert prediction is not None
    expected = np.linalg.matrix_power(motion, ahead)
    assert_close(prediction.T_reference_camera, expected, 0.003 * ahead, 0.05)


def test_a_longer_prediction_is_less_certain() -> None:
    model = moved(np.eye(4), 2)
    soon, later = model.predict(3 / RATE_HZ), model.predict(6 / RATE_HZ)
    assert soon is not None
    assert later is not None
    assert later.spread_rad > 1.5 * soon.spread_rad


def test_nothing_is_predicted_before_a_motion_or_long_after_it() -> None:
    model = ConstantVelocityModel()
    model.reset(0.0)
    assert model.predict(1 / RATE_HZ) is None
    model.add(np.eye(4), 1 / RATE_HZ)
    assert model.predict(2 / RATE_HZ) is not None
    assert model.predict(1 / RATE_HZ + 0.5) is None


def test_a_long_step_gives_no_velocity() -> None:
    model = moved(np.eye(4), 5)
    model.add(step([0.0, 0.3, 0.0], [1.0, 0.0, 0.0], 1.0), 5 / RATE_HZ + 1.0)
    assert model.predict(6 / RATE_HZ + 1.0) is None


def test_a_restart_resets_the_velocity() -> None:
    model = moved(np.eye(4), 5)
    model.reset(5 / RATE_HZ)
    assert model.predict(6 / RATE_HZ) is None


@pytest.mark.parametrize("stamp_s", [5 / RATE_HZ, 0.0, -3.0])
def test_stamps_that_repeat_or_go_back_are_no_error(stamp_s: float) -> None:
    model = moved(step([0.0, 0.3, 0.0], [0.2, 0.0, 0.0]), 5)
    assert model.predict(stamp_s) is None
    model.add(np.eye(4), stamp_s)
    assert model.predict(stamp_s + 1 / RATE_HZ) is None


numbers = st.floats(-100.0, 100.0)
vectors = st.lists(numbers, min_size=3, max_size=3)


@given(vectors, vectors, st.floats(0.001, 0.199))
def test_predictions_have_a_maximum_speed(
    turn_rad_s: list[float], speed_m_s: list[float], ahead_s: float
) -> None:
    prediction = moved(step(turn_rad_s, speed_m_s), 3).predict(3 / RATE_HZ + ahead_s)
    assert prediction is not None
    T = prediction.T_reference_camera
    assert np.linalg.norm(T[:3, 3]) <= MAX_SPEED_M_S * ahead_s + 1e-6
    assert rotation_angle_rad(T[:3, :3]) <= MAX_TURN_RATE_RAD_S * ahead_s + 1e-6
