"""A walk around the tables in the middle of the room, with fast turns of the camera."""

import numpy as np

from drivers.core.geometry import Array
from drivers.synthetic.motion.base import CameraMotion, look_rotations, rotations_from_vectors
from drivers.synthetic.motion.sinusoidal import TREMOR, Sinusoids, SinusoidSum

LAP_S = 20.0
RADIUS_M = 1.75
CAMERA_HEIGHT_M = 1.35
TARGET_HEIGHT_M = 0.6
# Deviation from an even walk, radians; the speed is then 0.3 to 0.8 meters per second.
PHASE_VARIATION_RAD = 0.4
SWAY: tuple[Sinusoids, ...] = (
    ((0.12, 0.10), (0.04, 0.30)),  # radius
    ((0.00, 0.10),),
    ((0.10, 0.10), (0.04, 0.25)),  # height
    ((0.05, 0.15),),  # yaw
    ((0.05, 0.15),),  # pitch
    ((0.08, 0.15),),  # roll
)
# Looks aside (yaw) and up and down (pitch): amplitude in radians, period in seconds.
# Between two of them the camera faces the middle; the fastest turn is 37 degrees per second.
LOOK_ASIDE = ((0.45, 5.0), (0.12, 4.0))


class OrbitMotion(CameraMotion):
    """Laps of about `LAP_S` around the middle; a shorter sequence goes part of one and back."""

    def __init__(self, rng: np.random.Generator, duration_s: float) -> None:
        self._sway = SinusoidSum.random(rng, duration_s, SWAY)
        self._tremor = SinusoidSum.random(rng, duration_s, TREMOR)
        self._start_rad = rng.uniform(0.0, 2 * np.pi)
        self._duration_s = duration_s

    def poses(self, times_s: Array) -> Array:
        """See `CameraMotion`."""
        sway, tremor = self._sway(times_s), self._tremor(times_s)
        along, aside = (
            self._orbit_angle_rad(times_s),
            [self._look_offset_rad(times_s, *g) for g in LOOK_ASIDE],
        )
        radius_m, height_m = RADIUS_M + sway[:, 0], CAMERA_HEIGHT_M + sway[:, 2]
        down = np.arctan2(height_m - TARGET_HEIGHT_M, radius_m)
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        eye_m = [radius_m * np.cos(along), radius_m * np.sin(along), height_m]
        T[:, :3, 3] = np.stack(eye_m, axis=1) + tremor[:, :3]
        yaw = along + np.pi / 2 + aside[0] + sway[:, 3]  # to the middle, except when looking aside
        T[:, :3, :3] = look_rotations(yaw, down + aside[1] + sway[:, 4], sway[:, 5])
        T[:, :3, :3] = T[:, :3, :3] @ rotations_from_vectors(tremor[:, 3:])
        return T

    def _orbit_angle_rad(self, times_s: Array) -> Array:
        """Angle on the circle."""
        laps = round(self._duration_s / LAP_S)
        phase = 2 * np.pi * times_s / self._duration_s
        uneven = min(PHASE_VARIATION_RAD, self._duration_s / LAP_S)
        result: Array = self._start_rad + laps * phase + uneven * np.sin(phase)
        return result

    def _look_offset_rad(self, times_s: Array, amplitude_rad: float, every_s: float) -> Array:
        times = round(self._duration_s / every_s)
        result: Array = amplitude_rad * np.sin(2 * np.pi * times * times_s / self._duration_s) ** 3
        return result
