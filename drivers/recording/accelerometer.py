"""Readings of a recording's accelerometer, and gravity by them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivers.camera import MAX_ACCELEROMETER_READINGS, AccelerometerReading
from drivers.core.geometry import Array, Vector, is_gravity

AVERAGING_WINDOW_S = 1.0


@dataclass(frozen=True)
class AccelerometerSeries:
    """Readings of an accelerometer: (N, 3) m/s^2 in camera axes, at rising stamps (N,)."""

    stamps_s: Array
    acceleration_m_s2: Array

    def gravity_at(self, stamp_s: float) -> Vector | None:
        """Return gravity by the reading with this stamp, else by the mean of the second before.

        Readings of other lengths than gravity's are left out; None without any. This program's
        recordings have one reading per frame, which is already smoothed.
        """
        stamps_s, gravity_m_s2 = self._gravity
        end = int(np.searchsorted(stamps_s, stamp_s, side="right"))
        begin = int(np.searchsorted(stamps_s, stamp_s - AVERAGING_WINDOW_S))
        if end == begin:
            return None
        if stamps_s[end - 1] == stamp_s:
            begin = end - 1
        x, y, z = gravity_m_s2[begin:end].mean(axis=0).tolist()
        return (x, y, z)

    def newest_at(self, stamp_s: float) -> tuple[AccelerometerReading, ...]:
        """Return the newest readings up to a frame's stamp, see `RgbdFrame.accelerometer`."""
        end = int(np.searchsorted(self.stamps_s, stamp_s, side="right"))
        rows = slice(max(0, end - MAX_ACCELEROMETER_READINGS), end)
        numbers = zip(
            self.stamps_s[rows].tolist(), self.acceleration_m_s2[rows].tolist(), strict=True
        )
        return tuple(AccelerometerReading(stamp_s, (x, y, z)) for stamp_s, (x, y, z) in numbers)

    @property
    def gravity_count(self) -> int:
        """The number of readings that gravity alone explains."""
        return len(self._gravity[0])

    @cached_property
    def _gravity(self) -> tuple[Array, Array]:
        """Stamps and gravity of the readings that gravity alone explains."""
        gravity_m_s2 = -self.acceleration_m_s2
        kept = np.array([is_gravity((x, y, z)) for x, y, z in gravity_m_s2.tolist()], bool)
        return self.stamps_s[kept], gravity_m_s2[kept]
