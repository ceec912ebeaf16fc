"""What a viewer can draw of an alignment: where the reference's planes lie in the image."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.odometry.icp.alignment import IcpAlignment, PlanePyramid
from vo_service.odometry.icp.depth_pyramid import DepthLevel, DepthPyramid
from vo_service.odometry.icp.residuals import compute_residuals
from vo_service.types import TrackingDebug

# A plane agrees with a reading that is off by no more than this, in standard deviations.
INLIER_SIGMAS = 3.0


def make_tracking_debug(
    planes: PlanePyramid, view: DepthPyramid, alignment: IcpAlignment
) -> TrackingDebug:
    """The planes in view; those with a reading as matches, with their place in the reference."""
    level = view.levels[0]
    located = compute_residuals(
        planes[0], alignment.T_camera_reference, level.inverse_depth, level.intrinsics
    )
    is_matched = ~np.isnan(located[:, 2])
    return TrackingDebug(
        keypoints_px=_to_full_resolution(located[np.isfinite(located[:, 0]), :2], level),
        matches_px=_to_full_resolution(located[is_matched, :2], level),
        reference_matches_px=project_planes(planes, view)[is_matched],
        inlier=np.abs(located[is_matched, 2]) <= INLIER_SIGMAS * alignment.sigma,
    )


def project_planes(planes: PlanePyramid, view: DepthPyramid) -> NDArray[np.float32]:
    """(N, 2) pixels of a reference's own planes in its image."""
    level = view.levels[0]
    fx, fy, cx, cy = level.intrinsics
    x, y, z = planes[0][:, :3].T
    return _to_full_resolution(np.column_stack([fx * x / z + cx, fy * y / z + cy]), level)


def _to_full_resolution(pixels: Array, level: DepthLevel) -> NDArray[np.float32]:
    """Pixels of the whole image, from those of a level; centres of first pixels are (0, 0)."""
    whole: NDArray[np.float32] = (level.scale * (pixels + 0.5) - 0.5).astype(np.float32)
    return whole
