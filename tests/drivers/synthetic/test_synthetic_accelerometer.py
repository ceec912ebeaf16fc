"""The accelerometer of the virtual Kinect."""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import STANDARD_GRAVITY_M_S2, Array
from drivers.synthetic.accelerometer import SyntheticAccelerometer
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import AccelerometerModel, MotionKind, SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.room import ROOM_HEIGHT_M

EXACT = AccelerometerModel(noise_m_s2=0.0, bias_m_s2=(0.0, 0.0, 0.0))
UP = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


class Accelerating(CameraMotion):
    """Camera axes are those of the room; it speeds up along x by 0.5 m/s^2."""

    def poses(self, times_s: Array) -> Array:
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, 0, 3] = 0.25 * times_s**2
        return T


def readings(model: AccelerometerModel, motion: CameraMotion, count: int = 300) -> Array:
    sensor = SyntheticAccelerometer(replace(SyntheticConfig(), accelerometer=model), motion)
    return np.array([sensor.reading_m_s2(seq) for seq in range(1, count)])


def test_a_perfect_one_measures_gravity_and_motion() -> None:
    np.testing.assert_allclose(readings(EXACT, Accelerating()) - UP, [[0.5, 0, 0]] * 299, atol=1e-9)


def test_noise_and_bias_are_those_of_the_configuration() -> None:
    model = AccelerometerModel(noise_m_s2=0.2, bias_m_s2=(0.1, -0.2, 0.3))
    error = readings(model, Accelerating(), 1000) - UP - [0.5, 0.0, 0.0]
    np.testing.assert_allclose(error.mean(axis=0), model.bias_m_s2, atol=0.03)
    np.testing.assert_allclose(error.std(axis=0), 0.2, rtol=0.1)


def test_two_cameras_read_the_same_in_any_order() -> None:
    config = SyntheticConfig(motion=MotionKind.STILL)
    one, other = (
        SyntheticAccelerometer(config, make_motion(config, ROOM_HEIGHT_M)) for _ in range(2)
    )
    assert other.reading_m_s2(40) == one.reading_m_s2(40)
    assert one.gravity_m_s2(40) == other.gravity_m_s2(40)


def test_gravity_is_the_mean_of_a_second() -> None:
    config = SyntheticConfig(motion=MotionKind.STILL)
    sensor = SyntheticAccelerometer(config, make_motion(config, ROOM_HEIGHT_M))
    found = sensor.gravity_m_s2(100)
    second = [sensor.reading_m_s2(seq) for seq in range(100, 70, -1)]
    np.testing.assert_allclose(found, -np.mean(second, axis=0))
