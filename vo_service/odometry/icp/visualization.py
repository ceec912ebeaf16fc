"""Debug data of an alignment for a viewer: the reference's planes in the image."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.odometry.icp.alignment import IcpAlignment, PlanePyramid
from vo_service.odometry.icp.depth_pyramid import DepthLevel, DepthPyramid
from vo_service.odometry.icp.residuals import compute_residuals
from vo_service.types import TrackingDebug

# Gate of an inlier, in standard deviations.
INLIER_SIGMAS = 3.0


def make_tracking_debug(
    planes: PlanePyramid, view: DepthPyramid, alignment: IcpAlignment
) -> TrackingDebug:
    """Make the debug data: planes in view, and as matches those with a reading."""
    level = view.levels[0]
    residuals = compute_residuals(
        planes[0], alignment.T_camera_reference, level.inverse_depth, level.intrinsics
    )
    is_matched = ~np.isnan(residuals[:, 2])
    return TrackingDebug(
        keypoints_px=_to_full_resolution(residuals[np.isfinite(residuals[:, 0]), :2], level),
        matches_px=_to_full_resolution(residuals[is_matched, :2], level),
        reference_matches_px=project_planes(planes, view)[is_matched],
        inlier=np.abs(residuals[is_matched, 2]) <= INLIER_SIGMAS * alignment.sigma,
    )


def project_planes(planes: PlanePyramid, view: DepthPyramid) -> NDArray[np.float32]:
    """(N, 2) pixels of a reference's planes in its own image."""
    level = view.levels[0]
    fx, fy, cx, cy = level.intrinsics
    x, y, z = planes[0][:, :3].T
    return _to_full_resolution(np.column_stack([fx * x / z + cx, fy * y / z + cy]), level)


def _to_full_resolution(pixels: Array, level: DepthLevel) -> NDArray[np.float32]:
    """Pixels of the whole image, from those of a level; centers of first pixels are (0, 0)."""
    whole: NDArray[np.float32] = (level.scale * (pixels + 0.5) - 0.5).astype(np.float32)
    return whole
