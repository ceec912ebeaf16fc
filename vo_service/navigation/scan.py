"""A laser scan of a depth image: the distance of the nearest obstacle in each direction."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.jit import kernel
from vo_service.navigation.depth_rays import (
    STRIDE,
    DepthRays,
    HeightBand,
    make_depth_rays,
    read_only,
)
from vo_service.navigation.level_view import LevelView

# Cells of equal size in 1/range, in which the noise of a Kinect's depth is the same everywhere.
CELLS = 400
# An obstacle has this many of the used pixels, in a window of three cells. With two, the noise at
# the edges of near surfaces made 0.8 % of the ranges more than 10 cm too short; with four, 0.5 %.
MIN_PIXELS = 4
# The rays are computed anew when the camera's tilt changes by more.
MAX_STALE_TILT_RAD = np.radians(0.1)


class ScanAngles(NamedTuple):
    """Directions of a scan, radians counterclockwise from x: bin 0 is on the right."""

    first_rad: float
    step_rad: float
    bins: int

    @classmethod
    def of_camera(cls, camera: PinholeCamera, step_rad: float) -> "ScanAngles":
        """Return the directions that a level camera sees; multiples of the step."""
        right = int(np.arctan2(camera.width - 1 - camera.cx, camera.fx) / step_rad)
        left = int(np.arctan2(camera.cx, camera.fx) / step_rad)
        return cls(-right * step_rad, step_rad, right + left + 1)


class Scanner:
    """Makes scans. Keeps the rays of the last tilt.

    Args:
        step_rad: Angle between two directions.
    """

    def __init__(self, step_rad: float) -> None:
        self._step_rad = step_rad
        self._camera: PinholeCamera | None = None
        self._view: LevelView | None = None
        self._rays: DepthRays | None = None
        self._angles = ScanAngles(0.0, step_rad, 1)

    def scan(
        self, frame: RgbdFrame, view: LevelView, band: HeightBand
    ) -> tuple[ScanAngles, NDArray[np.float32]]:
        """Scan a frame.

        Returns:
            The directions, and by direction the range in meters; +inf if obstacles are seen only
            beyond the largest range; NaN if it is unknown.
        """
        rays = self._rays_of(frame.camera, view)
        angles = self._angles
        counts = np.zeros((angles.bins, CELLS), np.uint16)
        sums_m = np.zeros((angles.bins, CELLS), np.float32)
        beside = np.zeros((angles.bins, 2), np.uint32)
        ranges_m = np.empty(angles.bins, np.float32)
        _scan(
            read_only(frame.depth_raw),
            np.float32(1.0 / frame.depth_factor),
            rays,
            band,
            counts,
            sums_m,
            beside,
            ranges_m,
        )
        return angles, ranges_m

    def _rays_of(self, camera: PinholeCamera, view: LevelView) -> DepthRays:
        is_valid = (
            self._camera == camera
            and self._view is not None
            and view.is_near(self._view, MAX_STALE_TILT_RAD)
        )
        if self._rays is None or not is_valid:
            self._camera, self._view = camera, view
            self._angles = ScanAngles.of_camera(camera, self._step_rad)
            self._rays = make_depth_rays(camera, view.R_level_camera, *self._angles)
        return self._rays


@kernel
def _scan(
    depth_raw: NDArray[np.uint16],
    meters: np.float32,
    rays: DepthRays,
    band: HeightBand,
    counts: NDArray[np.uint16],
    sums_m: NDArray[np.float32],
    beside: NDArray[np.uint32],
    ranges_m: NDArray[np.float32],
) -> None:
    """Fill `ranges_m` (bins,).

    Args:
        counts: (bins, cells) zeros: pixels with an obstacle, by cell of 1/range.
        sums_m: (bins, cells) zeros: sum of their ranges.
        beside: (bins, 2) zeros: pixels with an obstacle below the least range, and beyond the
            largest one.
    """
    camera_m, rise = np.float32(band.camera_m), np.float32(band.rise)
    min_m, top_m = np.float32(band.min_m), np.float32(band.max_m)
    least_m, most_m = np.float32(band.range_min_m), np.float32(band.range_max_m)
    nearest_inverse = np.float32(1.0) / least_m
    scale = np.float32(CELLS) / (nearest_inverse - np.float32(1.0) / most_m)
    obstacles_m = np.empty(rays.bin.shape[1], np.float32)
    for i in range(rays.bin.shape[0]):
        # A loop without jumps, which the compiler vectorizes; then one that fills the cells.
        for j in range(obstacles_m.size):
            z = np.float32(depth_raw[i * STRIDE, j * STRIDE]) * meters
            range_m = z * rays.horizontal[i, j]
            height_m = camera_m + z * rays.vertical[i, j]
            is_obstacle = (height_m >= min_m + range_m * rise) & (height_m <= top_m)
            obstacles_m[j] = range_m if is_obstacle else np.float32(0.0)
        for j in range(obstacles_m.size):
            range_m, number = obstacles_m[j], rays.bin[i, j]
            if range_m == 0 or number < 0:  # 0: no obstacle, or no depth
                continue
            if range_m < least_m:
                beside[number, 0] += 1
            elif range_m >= most_m:
                beside[number, 1] += 1
            else:
                cell = int((nearest_inverse - np.float32(1.0) / range_m) * scale)
                cell = min(cell, CELLS - 1)
                counts[number, cell] += 1
                sums_m[number, cell] += range_m
    for number in range(ranges_m.size):
        if beside[number, 0] >= MIN_PIXELS:  # nearer than can be told
            ranges_m[number] = np.nan
            continue
        ranges_m[number] = np.inf if beside[number, 1] >= MIN_PIXELS else np.nan
        for cell in range(CELLS - 2):
            count = counts[number, cell] + counts[number, cell + 1] + counts[number, cell + 2]
            if count >= MIN_PIXELS:
                total = sums_m[number, cell] + sums_m[number, cell + 1] + sums_m[number, cell + 2]
                ranges_m[number] = total / np.float32(count)
                break
