"""What has moved: surfaces where another keyframe has looked right through them.

Where a keyframe saw a surface, there was nothing between that surface and its camera. What stands
there now has come by itself, and whatever else it does, the camera's motion is not told by it.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, inverse
from drivers.jit import inline_kernel, kernel
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.parameters import OTHER_SURFACE_PER_M
from vo_service.odometry.keyframe.readings import NEAREST_M
from vo_service.odometry.keyframe.rows import project

# The view is told apart in blocks of so many pixels. Neighbours whose 1/z differs by less than
# this, 1/m, are of one surface.
BLOCK_PX = 8
CONNECTED_PER_M = 0.01
# All that is within so many pixels of a place has to be further away: edges are not where they
# were by a pixel or two, and rows are not of one instant.
MARGIN_PX = 6
LEAST_SEEN = 0.25
# What is known of a block.
UNKNOWN, SEEN, SEEN_THROUGH = 0, 1, 2

Blocks = NDArray[np.uint8]


def without_intruders(keyframe: Keyframe, others: Iterable[Keyframe]) -> Keyframe:
    """A keyframe without the points of surfaces that the others have looked through."""
    inverse_depth, intrinsics = keyframe.images.inverse_depth, keyframe.images.intrinsics[0]
    height, width = inverse_depth.shape
    known = np.zeros((height // BLOCK_PX, width // BLOCK_PX), np.uint8)
    for other in others:
        T_other_keyframe = inverse(other.T_world_keyframe) @ keyframe.T_world_keyframe
        compare(inverse_depth, intrinsics, T_other_keyframe, other.images.inverse_depth, known)
    if (known != UNKNOWN).mean() < LEAST_SEEN:
        return keyframe
    moved = grow(inverse_depth, known)
    points = tuple(level[~_is_in(level, intrinsics, moved)] for level in keyframe.points)
    return replace(keyframe, points=points)


@kernel
def compare(
    inverse_depth: NDArray[np.float32],
    intrinsics: Array,
    T_other_camera: Array,
    other_inverse_depth: NDArray[np.float32],
    known: Blocks,
) -> None:
    """Note of each block (rows, columns) what another view of the same camera tells of it."""
    height, width = inverse_depth.shape
    T = T_other_camera
    fx, fy, cx, cy = intrinsics
    for i in range(known.shape[0]):
        for j in range(known.shape[1]):
            column, row = j * BLOCK_PX + BLOCK_PX // 2, i * BLOCK_PX + BLOCK_PX // 2
            if known[i, j] == SEEN_THROUGH or inverse_depth[row, column] <= 0.0:
                continue
            pz = 1.0 / inverse_depth[row, column]
            px, py = (column - cx) / fx * pz, (row - cy) / fy * pz
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            if z < NEAREST_M:
                continue
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            u, v = project(x, y, z, intrinsics)
            if (
                MARGIN_PX <= u < width - MARGIN_PX - 1
                and MARGIN_PX <= v < height - MARGIN_PX - 1
            ):
                told = _look(other_inverse_depth, int(u + 0.5), int(v + 0.5), 1.0 / z)
                known[i, j] = max(known[i, j], told)


@inline_kernel
def _look(inverse_depth: NDArray[np.float32], column: int, row: int, w: float) -> int:
    """What a view tells of a surface at 1/z of w in one of its pixels."""
    middle = inverse_depth[row, column]
    if middle <= 0.0 or middle > w + OTHER_SURFACE_PER_M:
        return UNKNOWN
    if middle >= w - OTHER_SURFACE_PER_M:
        return SEEN
    for dv in range(-MARGIN_PX, MARGIN_PX + 1, MARGIN_PX):
        for du in range(-MARGIN_PX, MARGIN_PX + 1, MARGIN_PX):
            around = inverse_depth[row + dv, column + du]
            if not 0.0 < around < w - OTHER_SURFACE_PER_M:
                return UNKNOWN
    return SEEN_THROUGH


@kernel
def grow(inverse_depth: NDArray[np.float32], known: Blocks) -> NDArray[np.bool_]:
    """(rows, columns) blocks seen through, the surfaces they are most known of, and a rim around."""
    rows, columns = known.shape
    middle = BLOCK_PX // 2
    moved = np.zeros((rows, columns), np.bool_)
    is_done = np.zeros((rows, columns), np.bool_)
    surface = np.empty((rows * columns, 2), np.int64)
    for i in range(rows):
        for j in range(columns):
            if is_done[i, j] or inverse_depth[i * BLOCK_PX + middle, j * BLOCK_PX + middle] <= 0.0:
                continue
            surface[0, 0], surface[0, 1] = i, j
            is_done[i, j] = True
            size, n, through, seen = 1, 0, 0, 0
            while n < size:
                a, b = surface[n]
                n += 1
                through += known[a, b] == SEEN_THROUGH
                seen += known[a, b] == SEEN
                w = inverse_depth[a * BLOCK_PX + middle, b * BLOCK_PX + middle]
                for da, db in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                    c, d = a + da, b + db
                    if not (0 <= c < rows and 0 <= d < columns) or is_done[c, d]:
                        continue
                    beside = inverse_depth[c * BLOCK_PX + middle, d * BLOCK_PX + middle]
                    if beside > 0.0 and abs(beside - w) < CONNECTED_PER_M:
                        is_done[c, d] = True
                        surface[size, 0], surface[size, 1] = c, d
                        size += 1
            for n in range(size):
                a, b = surface[n]
                if through > seen or seen < LEAST_SEEN * size or known[a, b] == SEEN_THROUGH:
                    moved[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2] = True
    return moved


@kernel
def _is_in(points: Array, intrinsics: Array, blocks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) which points lie in the blocks."""
    rows, columns = blocks.shape
    is_in = np.zeros(len(points), np.bool_)
    for n in range(len(points)):
        u, v = project(points[n, 0], points[n, 1], points[n, 2], intrinsics)
        i = min(max(int(v / BLOCK_PX), 0), rows - 1)
        j = min(max(int(u / BLOCK_PX), 0), columns - 1)
        is_in[n] = blocks[i, j]
    return is_in
