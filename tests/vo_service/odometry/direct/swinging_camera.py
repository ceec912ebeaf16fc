"""Views of a camera in a shaking hand, which tell nothing of the sensor's timing."""

from dataclasses import replace
from functools import cache

import numpy as np

from drivers.camera import RgbdFrame, TimingPrior, TimingSource
from drivers.core.geometry import Array
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    MovingCamera,
    add_noise,
    render_view,
    series_exponential,
)

READOUT_S, DELAY_S = 0.020, 0.008
UNKNOWN = TimingPrior(0.0, 0.03, 0.01, TimingSource.UNKNOWN)
# Radius and frequency of a hand's motion: up to 1 rad/s and 0.5 m/s.
SWING = np.array([0.06, 0.05, 0.04, 0.11, 0.13, 0.10])
SWING_RAD_S = np.array([7.0, 8.0, 6.0, 9.0, 8.0, 7.0])


class SwingingCamera(MovingCamera):
    """A camera in a hand that shakes it."""

    def poses_at(self, times_s: Array) -> Array:
        """(T, 4, 4) T_world_camera."""
        return series_exponential(SWING * np.sin(times_s[:, None] * SWING_RAD_S))


@cache
def swinging_frames(readout_s: float, delay_s: float) -> tuple[RgbdFrame, ...]:
    """Two seconds with noise; the frames tell neither readout nor delay."""
    views = [
        add_noise(render_view(SwingingCamera(), k / 30, readout_s=readout_s, skew_s=delay_s), k)
        for k in range(60)
    ]
    return tuple(replace(f, readout_s=0.0, skew_s=0.0, timing_prior=UNKNOWN) for f in views)
