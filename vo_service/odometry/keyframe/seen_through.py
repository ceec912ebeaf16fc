"""What has moved: points that another keyframe has looked right through.

Where a keyframe saw a surface, there was nothing between that surface and its camera. What stands
there now has come by itself, and whatever else it does, the camera's motion is not told by it.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, inverse
from drivers.jit import kernel
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.parameters import OTHER_SURFACE_PER_M
from vo_service.odometry.keyframe.readings import NEAREST_M
from vo_service.odometry.keyframe.rows import project

# All that is within so many pixels of a point has to be further away: edges are not where they
# were by a pixel or two, and rows are not of one instant.
MARGIN_PX = 6


def without_intruders(keyframe: Keyframe, others: Iterable[Keyframe]) -> Keyframe:
    """A keyframe without the points that one of the others has looked through."""
    points = keyframe.points
    for other in others:
        T_other_keyframe = inverse(other.T_world_keyframe) @ keyframe.T_world_keyframe
        images = other.images
        points = tuple(
            level[~seen_through(level, T_other_keyframe, images.inverse_depth, images.intrinsics[0])]
            for level in points
        )
    return replace(keyframe, points=points)


@kernel
def seen_through(
    points: Array,
    T_camera_points: Array,
    inverse_depth: NDArray[np.float32],
    intrinsics: Array,
) -> NDArray[np.bool_]:
    """(N,) which points are in front of all that a depth image shows around them."""
    height, width = inverse_depth.shape
    is_seen_through = np.zeros(len(points), np.bool_)
    T = T_camera_points
    for n in range(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if z < NEAREST_M:
            continue
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        u, v = project(x, y, z, intrinsics)
        if not (MARGIN_PX <= u < width - MARGIN_PX - 1 and MARGIN_PX <= v < height - MARGIN_PX - 1):
            continue
        column, row = int(u + 0.5), int(v + 0.5)
        most = 1.0 / z - OTHER_SURFACE_PER_M
        is_open = True
        for dv in range(-MARGIN_PX, MARGIN_PX + 1, MARGIN_PX // 2):
            for du in range(-MARGIN_PX, MARGIN_PX + 1, MARGIN_PX // 2):
                w = inverse_depth[row + dv, column + du]
                is_open = is_open and 0.0 < w < most
        is_seen_through[n] = is_open
    return is_seen_through
