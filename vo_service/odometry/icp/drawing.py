"""What a viewer can draw of an alignment: where the reference's planes lie in the image."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from vo_service.odometry.icp.alignment import Alignment, Planes
from vo_service.odometry.icp.pyramid import DepthPyramid, Level
from vo_service.odometry.icp.residuals import locate
from vo_service.types import Evidence

# A plane agrees with a reading that is off by no more than this, in standard deviations.
INLIER_SIGMAS = 3.0


def draw(planes: Planes, view: DepthPyramid, found: Alignment) -> Evidence:
    """The planes in view; those with a reading as matches, with their place in the reference."""
    level = view.levels[0]
    located = locate(planes[0], found.T_camera_reference, level.inverse_depth, level.intrinsics)
    is_matched = ~np.isnan(located[:, 2])
    return Evidence(
        keypoints_px=_in_whole_image(located[np.isfinite(located[:, 0]), :2], level),
        matches_px=_in_whole_image(located[is_matched, :2], level),
        reference_matches_px=draw_planes(planes, view)[is_matched],
        inlier=np.abs(located[is_matched, 2]) <= INLIER_SIGMAS * found.sigma,
    )


def draw_planes(planes: Planes, view: DepthPyramid) -> NDArray[np.float32]:
    """(N, 2) pixels of a reference's own planes in its image."""
    level = view.levels[0]
    fx, fy, cx, cy = level.intrinsics
    x, y, z = planes[0][:, :3].T
    return _in_whole_image(np.column_stack([fx * x / z + cx, fy * y / z + cy]), level)


def _in_whole_image(pixels: Array, level: Level) -> NDArray[np.float32]:
    """Pixels of the whole image, from those of a level; centres of first pixels are (0, 0)."""
    whole: NDArray[np.float32] = (level.scale * (pixels + 0.5) - 0.5).astype(np.float32)
    return whole
