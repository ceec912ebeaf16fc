"""The floor in a depth image: the lowest plane that is level, by the supposed up direction.

Heights above the supposed floor are binned by area; the lowest peak is refined on inverse depth,
whose noise is the same at all distances: 1/z = q . (x, y, 1), with up = -q/|q| and height = 1/|q|.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array

# Every n-th pixel of every n-th row is used.
PIXEL_STRIDE = 8
# Farther readings are too noisy, m.
MAX_RANGE_M = 4.5
# A peak of the histogram of heights has at least this share of the area in view.
BIN_M, MIN_PEAK_SHARE = 0.04, 0.1
# Largest error of inverse depth of the floor's readings, 1/m, at each refinement; the last ones
# follow the scatter of the readings.
MAX_ERROR_PER_M = (0.06, 0.03, 0.015, 0.015)
MAX_ERROR_SIGMAS = 2.0
MIN_READINGS = 60
# The floor's readings reach over at least this distance, so that a step is not taken for it.
MIN_EXTENT_M = 1.0
# The floor is at least this far below the camera.
MIN_HEIGHT_M = 0.1


@dataclass(frozen=True)
class FloorPlane:
    """The floor below a camera.

    Attributes:
        up: (3,) unit vector in camera axes, normal to the floor.
        height_m: Of the camera above the floor.
        readings: Number of readings on it.
    """

    up: Array
    height_m: float
    readings: int


class FloorDetector:
    """Finds the floor in depth images of one camera.

    Args:
        camera: Intrinsics of the depth image.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = camera
        v, u = np.mgrid[
            PIXEL_STRIDE // 2 : camera.height : PIXEL_STRIDE,
            PIXEL_STRIDE // 2 : camera.width : PIXEL_STRIDE,
        ]
        rays = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape))
        self._rays = np.stack(rays, axis=-1).reshape(-1, 3)

    def find(self, frame: RgbdFrame, up: Array, max_tilt_rad: float) -> FloorPlane | None:
        """Find the floor; None if the view does not show it.

        Args:
            frame: Its depth is used.
            up: (3,) supposed up direction in camera axes.
            max_tilt_rad: Largest angle of the floor's normal from it.
        """
        if frame.depth_raw.shape != (self.camera.height, self.camera.width):
            return None
        half = PIXEL_STRIDE // 2
        depth_m = frame.depth_raw[half::PIXEL_STRIDE, half::PIXEL_STRIDE].ravel() / (
            frame.depth_factor
        )
        used = (depth_m > 0.0) & (depth_m < MAX_RANGE_M)
        rays, depth_m = self._rays[used], depth_m[used]
        below_m = -depth_m * (rays @ up)
        height_m = _lowest_peak_m(below_m, depth_m**2)
        if height_m is None:
            return None
        q, inverse_depth_per_m = -up / height_m, 1.0 / depth_m
        for limit in MAX_ERROR_PER_M:
            error = np.abs(inverse_depth_per_m - rays @ q)
            inlier = error < limit
            if np.any(inlier):
                inlier = error < MAX_ERROR_SIGMAS * 1.4826 * np.median(error[inlier])
            if np.count_nonzero(inlier) < MIN_READINGS:
                return None
            on_floor = rays[inlier]
            normal_matrix, vector = on_floor.T @ on_floor, on_floor.T @ inverse_depth_per_m[inlier]
            q = np.linalg.lstsq(normal_matrix, vector, rcond=None)[0]
        found = FloorPlane(-q / np.linalg.norm(q), float(1.0 / np.linalg.norm(q)), len(on_floor))
        if found.up @ up < np.cos(max_tilt_rad) or _extent_m(depth_m[inlier]) < MIN_EXTENT_M:
            return None
        return found


def _lowest_peak_m(below_m: Array, area: Array) -> float | None:
    """Distance below the camera of the lowest level surface with enough area; None without one."""
    is_below = below_m > MIN_HEIGHT_M
    bins = (below_m[is_below] / BIN_M).astype(np.intp)
    if len(bins) < MIN_READINGS:
        return None
    histogram = np.bincount(bins, weights=area[is_below])
    peaks = np.flatnonzero(histogram >= MIN_PEAK_SHARE * area.sum())
    return None if len(peaks) == 0 else (int(peaks[-1]) + 0.5) * BIN_M


def _extent_m(depth_m: NDArray[np.float64]) -> float:
    """Span of depth without the outer hundredths, m."""
    near_m, far_m = np.percentile(depth_m, (1, 99))
    return float(far_m - near_m)
