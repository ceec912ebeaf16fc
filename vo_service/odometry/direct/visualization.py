"""Debug data of an alignment for a viewer: the keyframe's points in the image."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.local_map import DirectKeyframe
from vo_service.odometry.direct.residual_stats import find_inliers
from vo_service.odometry.direct.warping import SAMPLE_BRIGHTNESS, SAMPLE_CELL, SAMPLE_U, SAMPLE_V
from vo_service.types import TrackingDebug

# Every 4th point is enough to see.
POINT_STRIDE = 4


def make_tracking_debug(keyframe: DirectKeyframe, alignment: DirectAlignment) -> TrackingDebug:
    """Make the debug data of every 4th point; matches are points with a brightness sample."""
    samples = alignment.samples[::POINT_STRIDE]
    pixels = samples[:, [SAMPLE_U, SAMPLE_V]].astype(np.float32)
    is_sampled = ~np.isnan(samples[:, SAMPLE_BRIGHTNESS])
    return TrackingDebug(
        keypoints_px=pixels[samples[:, SAMPLE_CELL] >= 0],
        matches_px=pixels[is_sampled],
        reference_matches_px=project_keyframe_points(keyframe)[is_sampled],
        inlier=find_inliers(keyframe.points[0][::POINT_STRIDE], samples, alignment.residual_model)[
            is_sampled
        ],
    )


def project_keyframe_points(keyframe: DirectKeyframe) -> NDArray[np.float32]:
    """(N, 2) pixels of every 4th keyframe point in the keyframe's image."""
    fx, fy, cx, cy = keyframe.images.intrinsics[0]
    x, y, z = keyframe.points[0][::POINT_STRIDE, :3].T
    pixels: Array = np.column_stack([fx * x / z + cx, fy * y / z + cy])
    return pixels.astype(np.float32)
