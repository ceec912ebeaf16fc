"""Complementary filter of the up direction and of the floor's height in `odom`.

Mahony, Hamel and Pflimlin, "Nonlinear Complementary Filters on the Special Orthogonal Group" (IEEE
Transactions on Automatic Control 53, 2008): odometry drifts slowly, and a measured up direction
pulls it back. Corrections are so slow that no reader of the pose sees a jump.
"""

from dataclasses import dataclass
from math import hypot, inf, radians, sqrt

import numpy as np

from drivers.core.geometry import STANDARD_GRAVITY_M_S2, Array
from vo_service.types.level import LevelSource

# Time constant of the corrections by each source, s.
TIME_S = {LevelSource.FLOOR: 1.0, LevelSource.MOUNT: 10.0, LevelSource.ACCELEROMETER: 15.0}
# Standard deviation of the up direction by each source. Depth bends a floor a little; a floor is
# not even; a Kinect's accelerometer is 0.02 g off until its bias is known.
SIGMA_RAD = {
    LevelSource.FLOOR: radians(0.2),
    LevelSource.MOUNT: radians(0.5),
    LevelSource.ACCELEROMETER: radians(1.2),
    LevelSource.ASSUMED: 0.0,
}
UNBIASED_ACCELEROMETER_SIGMA_RAD = radians(0.4)
# Drift of the odometry's up direction, rad per root second.
DRIFT_RAD_PER_ROOT_S = radians(0.05)
# Another source carries over if no floor was in view for this time, s.
MAX_FLOOR_AGE_S = 1.0
# Fastest corrections, and the longest time that one step makes up for.
MAX_RATE_RAD_S, MAX_RATE_M_S = radians(0.5), 0.02
MAX_STEP_S = 0.05
# A reading whose length differs by more from gravity, relative to it, contains a motion.
MAX_ACCELERATION = 0.05
# The bias is the mean over the first time with the floor in view; it is used after the second one.
BIAS_TIME_S, MIN_BIAS_TIME_S = 300.0, 20.0


@dataclass(frozen=True)
class LevelCorrection:
    """One step of the correction.

    Attributes:
        turn_rad: (3,) rotation vector in `odom`; horizontal.
        shift_m: Along z of `odom`.
    """

    turn_rad: Array
    shift_m: float


class LevelFilter:
    """Estimates how far `odom` is from level, and corrects it step by step.

    Attributes:
        source: Where the up direction comes from.
        bias_m_s2: (3,) bias of the accelerometer in camera axes.
    """

    def __init__(self) -> None:
        self.source = LevelSource.ASSUMED
        self.bias_m_s2 = np.zeros(3)
        self._bias_time_s = 0.0
        self._variance = 0.0
        self._tilt_error_rad, self._height_error_m = np.zeros(3), 0.0
        self._stamp_s = inf
        self._reading_s = self._floor_s = -inf

    def start(
        self, source: LevelSource, bias_m_s2: tuple[float, float, float] | None = None
    ) -> None:
        """Begin with an `odom` that is level by a source.

        Args:
            bias_m_s2: (3,) bias of the accelerometer that an earlier run has learned.
        """
        self.source = source
        self._variance = self._sigma_rad**2
        self._tilt_error_rad, self._height_error_m = np.zeros(3), 0.0
        if bias_m_s2 is not None and not self._bias_time_s:
            self.bias_m_s2, self._bias_time_s = np.array(bias_m_s2), MIN_BIAS_TIME_S

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the up direction; 0 = unknown."""
        return sqrt(self._variance)

    @property
    def has_bias(self) -> bool:
        """Whether the accelerometer's bias is known well enough to be used."""
        return self._bias_time_s >= MIN_BIAS_TIME_S

    def is_floor_recent(self, stamp_s: float) -> bool:
        """Whether the floor was in view shortly before a stamp."""
        return stamp_s - self._floor_s <= MAX_FLOOR_AGE_S

    def add_floor(self, up: Array, height_error_m: float, stamp_s: float) -> None:
        """Add the floor of a view.

        Args:
            up: (3,) its normal in `odom`.
            height_error_m: How much too low the floor is in `odom`.
            stamp_s: Stamp of the view.
        """
        self._floor_s = stamp_s
        self._measure(LevelSource.FLOOR, up, height_error_m)

    def add_mount(self, up: Array, height_error_m: float) -> None:
        """Add what the mount tells of a base that stays level; see `add_floor`."""
        self._measure(LevelSource.MOUNT, up, height_error_m)

    def add_reading(self, R_odom_camera: Array, reading_m_s2: Array, stamp_s: float) -> None:
        """Add a reading of the accelerometer. While the floor is in view, its bias is learned.

        Args:
            R_odom_camera: 3x3 attitude of the camera.
            reading_m_s2: (3,) specific force in camera axes.
        """
        elapsed_s, self._reading_s = stamp_s - self._reading_s, stamp_s
        is_floor_recent = self.is_floor_recent(stamp_s)
        bias_m_s2 = self.bias_m_s2 if self.has_bias and not is_floor_recent else 0.0
        force_m_s2 = reading_m_s2 - bias_m_s2
        length_m_s2 = hypot(*force_m_s2)
        if not abs(length_m_s2 / STANDARD_GRAVITY_M_S2 - 1.0) <= MAX_ACCELERATION:  # or NaN
            return
        if not is_floor_recent:
            self._measure(LevelSource.ACCELEROMETER, R_odom_camera @ force_m_s2 / length_m_s2, 0.0)
        elif elapsed_s < MAX_FLOOR_AGE_S:
            self._bias_time_s = min(self._bias_time_s + elapsed_s, BIAS_TIME_S)
            error_m_s2 = force_m_s2 - STANDARD_GRAVITY_M_S2 * R_odom_camera[2]
            self.bias_m_s2 = self.bias_m_s2 + elapsed_s / self._bias_time_s * (
                error_m_s2 - self.bias_m_s2
            )

    def step(self, stamp_s: float) -> LevelCorrection:
        """Return the correction of a frame, and count it as done."""
        elapsed_s, self._stamp_s = min(max(stamp_s - self._stamp_s, 0.0), MAX_STEP_S), stamp_s
        if self.source is LevelSource.ASSUMED:
            return LevelCorrection(np.zeros(3), 0.0)
        share = elapsed_s / TIME_S[self.source]
        self._variance += share * (self._sigma_rad**2 - self._variance)
        self._variance += elapsed_s * DRIFT_RAD_PER_ROOT_S**2
        turn_rad, shift_m = share * self._tilt_error_rad, share * self._height_error_m
        turn_rad *= min(1.0, MAX_RATE_RAD_S * elapsed_s / max(hypot(*turn_rad), 1e-12))
        shift_m = max(-MAX_RATE_M_S * elapsed_s, min(shift_m, MAX_RATE_M_S * elapsed_s))
        self._tilt_error_rad = self._tilt_error_rad - turn_rad
        self._height_error_m -= shift_m
        return LevelCorrection(turn_rad, shift_m)

    def _measure(self, source: LevelSource, up: Array, height_error_m: float) -> None:
        self.source, self._height_error_m = source, height_error_m
        # The rotation vector that turns `up` to z.
        angle_rad = np.arctan2(hypot(up[0], up[1]), up[2])
        axis = np.array([up[1], -up[0], 0.0]) / max(hypot(up[0], up[1]), 1e-12)
        self._tilt_error_rad = angle_rad * axis

    @property
    def _sigma_rad(self) -> float:
        if self.source is LevelSource.ACCELEROMETER and self.has_bias:
            return UNBIASED_ACCELEROMETER_SIGMA_RAD
        return SIGMA_RAD[self.source]
