"""What a viewer can draw of an alignment: where the keyframe's points lie in the image."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.odometry.direct import warping as columns
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.local_map import DirectKeyframe
from vo_service.odometry.direct.residual_stats import find_inliers
from vo_service.types import TrackingDebug

# There are more points than anybody needs to see.
POINT_STRIDE = 4


def make_tracking_debug(keyframe: DirectKeyframe, alignment: DirectAlignment) -> TrackingDebug:
    """Every fourth point in view; matches are those with a reading."""
    readings = alignment.samples[::POINT_STRIDE]
    pixels = readings[:, [columns.SAMPLE_U, columns.SAMPLE_V]].astype(np.float32)
    is_read = ~np.isnan(readings[:, columns.SAMPLE_BRIGHTNESS])
    return TrackingDebug(
        keypoints_px=pixels[readings[:, columns.SAMPLE_CELL] >= 0],
        matches_px=pixels[is_read],
        reference_matches_px=project_keyframe_points(keyframe)[is_read],
        inlier=find_inliers(keyframe.points[0][::POINT_STRIDE], readings, alignment.residual_model)[
            is_read
        ],
    )


def project_keyframe_points(keyframe: DirectKeyframe) -> NDArray[np.float32]:
    """(N, 2) pixels of every fourth of a keyframe's own points in its image."""
    fx, fy, cx, cy = keyframe.images.intrinsics[0]
    x, y, z = keyframe.points[0][::POINT_STRIDE, :3].T
    pixels: Array = np.column_stack([fx * x / z + cx, fy * y / z + cy])
    return pixels.astype(np.float32)
