"""What a viewer can draw of an alignment: where the keyframe's points lie in the image."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from vo_service.odometry.keyframe import readings as columns
from vo_service.odometry.keyframe.alignment import Alignment
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.measure import is_agreeing
from vo_service.types import Evidence

# There are more points than anybody needs to see.
EACH = 4


def draw(keyframe: Keyframe, found: Alignment) -> Evidence:
    """Every fourth point in view; matches are those with a reading."""
    readings = found.readings[::EACH]
    pixels = readings[:, [columns.U, columns.V]].astype(np.float32)
    is_read = ~np.isnan(readings[:, columns.BRIGHTNESS])
    return Evidence(
        keypoints_px=pixels[readings[:, columns.CELL] >= 0],
        matches_px=pixels[is_read],
        reference_matches_px=draw_points(keyframe)[is_read],
        inlier=is_agreeing(keyframe.points[0][::EACH], readings, found.fit)[is_read],
    )


def draw_points(keyframe: Keyframe) -> NDArray[np.float32]:
    """(N, 2) pixels of every fourth of a keyframe's own points in its image."""
    fx, fy, cx, cy = keyframe.images.intrinsics[0]
    x, y, z = keyframe.points[0][::EACH, :3].T
    pixels: Array = np.column_stack([fx * x / z + cx, fy * y / z + cy])
    return pixels.astype(np.float32)
