"""The accelerometer of the virtual Kinect: gravity and motion in camera axes, noise and a bias."""

from functools import lru_cache

import numpy as np

from drivers.core.geometry import STANDARD_GRAVITY_M_S2, Array, Vector, is_gravity
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import SyntheticConfig

# The acceleration is the second difference of the position over this time, s.
DIFFERENCE_S = 0.02
# A driver averages gravity over this time, s.
AVERAGING_WINDOW_S = 1.0


class SyntheticAccelerometer:
    """An accelerometer beside the color camera, with one reading a frame.

    Args:
        config: Its noise, its bias and the frame rate.
        motion: The camera's motion.
    """

    def __init__(self, config: SyntheticConfig, motion: CameraMotion) -> None:
        self._config, self._motion = config, motion
        self._reading = lru_cache(maxsize=64)(self._measure)

    def reading_m_s2(self, seq: int) -> Vector:
        """Specific force at a frame, in camera axes; the room's z is up."""
        return self._reading(seq)

    def gravity_m_s2(self, seq: int) -> Vector:
        """Mean gravity of the last second, in camera axes. Before the first frame it is at rest."""
        count = round(AVERAGING_WINDOW_S * self._config.rate_hz)
        readings = [self._reading(seq - back) for back in range(max(count, 1))]
        at_rest = [each for each in readings if is_gravity(each)] or readings
        x, y, z = (-np.mean(at_rest, axis=0)).tolist()
        return (x, y, z)

    def _measure(self, seq: int) -> Vector:
        sensor, stamp_s = self._config.accelerometer, seq / self._config.rate_hz
        times_s = np.array([stamp_s - DIFFERENCE_S, stamp_s, stamp_s + DIFFERENCE_S])
        before, now, after = self._motion.poses(np.clip(times_s, 0.0, None))
        acceleration_m_s2 = (before - 2.0 * now + after)[:3, 3] / DIFFERENCE_S**2
        acceleration_m_s2[2] += STANDARD_GRAVITY_M_S2
        force_m_s2: Array = now[:3, :3].T @ acceleration_m_s2 + sensor.bias_m_s2
        rng = np.random.default_rng([self._config.seed, 7, int(seq >= 0), abs(seq)])
        x, y, z = (force_m_s2 + sensor.noise_m_s2 * rng.normal(size=3)).tolist()
        return (x, y, z)
