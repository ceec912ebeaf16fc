"""Rendered rolling-shutter sequences of a shaken camera."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.tum.writer import TumWriter
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    MovingCamera,
    add_noise,
    render_view,
    series_exponential,
)

SMALL = PinholeCamera(208, 156, 190.0, 190.0, 103.5, 77.5)
PERIOD_S = 0.55
# More than the maximum gap within a segment.
PAUSE_S = 0.2


@dataclass(frozen=True, eq=False)
class ShakenCamera(MovingCamera):
    """Camera that moves to and fro along the twist of the maximum velocity, and sideways."""

    def poses_at(self, times_s: Array) -> Array:
        """(T, 4, 4) T_world_camera."""
        w = 2 * np.pi / PERIOD_S
        t_s = times_s[:, None]
        forward = np.sin(w * t_s) / w * self.velocity
        sideways = np.sin(0.7 * w * t_s + 1.0) / w * np.roll(self.velocity, 1)
        return np.asarray(self.T_world_start @ series_exponential(forward + sideways), np.float64)


FAST_SHAKING = ShakenCamera(np.array([0.25, -0.2, 0.15, -0.6, 0.8, 0.4]))


def render_segment(readout_s: float, skew_s: float, frames: int = 32) -> list[RgbdFrame]:
    """Render a noisy segment; its stamps show no readout and no skew."""
    frames_exact = [
        render_view(FAST_SHAKING, n / 30, readout_s=readout_s, skew_s=skew_s, camera=SMALL)
        for n in range(frames)
    ]
    return [replace(add_noise(f, n), readout_s=0.0, skew_s=0.0) for n, f in enumerate(frames_exact)]


def record_repeated(folder: Path, segment: list[RgbdFrame], times: int) -> Path:
    """Record the same segment several times, with pauses in between."""
    length_s = segment[-1].stamp_s - segment[0].stamp_s + PAUSE_S
    with TumWriter(folder) as writer:
        for n in range(times):
            for frame in segment:
                writer.write(replace(frame, stamp_s=frame.stamp_s + n * length_s))
    return folder
