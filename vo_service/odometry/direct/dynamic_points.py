"""What a new keyframe takes no points from: things that came by themselves.

Where a keyframe has seen a surface, there was nothing before it. What stands there now has moved,
and whatever follows it does not follow the room. What comes in from outside of all that was seen
cannot be told by that: it has to wait until another keyframe has seen it where it is.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.derived_parameters import MAX_SURFACE_STEP_PER_M
from vo_service.odometry.direct.local_map import DirectKeyframe
from vo_service.odometry.direct.parameters import LITTLE
from vo_service.odometry.direct.rolling_shutter import project
from vo_service.odometry.direct.se3 import transform_point
from vo_service.odometry.direct.warping import MAX_SAME_SURFACE_PER_M, MIN_DEPTH_M

# The view is looked at in blocks of so many pixels, by the one in their middle.
BLOCK_PX, BLOCK_CENTER_PX = 8, 4
# A place is seen through if all that is so many pixels around it is further away: edges are not
# where they were by some pixels, and rows are not of one instant.
EDGE_MARGIN_PX = BLOCK_PX
# What others tell of a block.
UNKNOWN, OBSERVED, FREE_SPACE = 0, 1, 2

BlockStates = NDArray[np.uint8]
DepthBlocks = NDArray[np.float32]


def remove_dynamic_points(
    keyframe: DirectKeyframe, others: Iterable[DirectKeyframe]
) -> DirectKeyframe:
    """A keyframe without points of surfaces that others have looked through, or never seen.

    Where others know too little of the view, it is left as it is.
    """
    images = keyframe.images
    blocks = images.inverse_depth[BLOCK_CENTER_PX::BLOCK_PX, BLOCK_CENTER_PX::BLOCK_PX].copy()
    places = _backproject_blocks(blocks, images.intrinsics[0])
    known = np.zeros(blocks.shape, np.uint8)
    for other in others:
        T_other_keyframe = inverse(other.T_world_keyframe) @ keyframe.T_world_keyframe
        seen = other.images
        classify_from_view(T_other_keyframe, seen.inverse_depth, seen.intrinsics[0], places, known)
    if np.count_nonzero(known) < LITTLE * np.count_nonzero(blocks):
        return keyframe
    strange = find_dynamic_blocks(blocks, known)
    points = tuple(
        level[~are_in_blocks(level, images.intrinsics[0], strange)] for level in keyframe.points
    )
    return replace(keyframe, points=points)


def _backproject_blocks(blocks: DepthBlocks, intrinsics: Array) -> Array:
    """(rows, columns, 3) where the blocks are, in their camera's axes; 0 without a reading."""
    fx, fy, cx, cy = intrinsics
    rows, columns = np.indices(blocks.shape) * BLOCK_PX + BLOCK_CENTER_PX
    z = np.divide(1.0, blocks, out=np.zeros(blocks.shape), where=blocks > 0.0)
    return np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=-1)


@kernel
def classify_from_view(
    T_other_camera: Array,
    inverse_depth: DepthBlocks,
    intrinsics: Array,
    block_points: Array,
    states: BlockStates,
) -> None:
    """Note what another view tells of each place that nothing is known of yet.

    inverse_depth, intrinsics  (H, W) of the other view, 1/m; 0 = no reading
    places                     (rows, columns, 3) in the camera's axes, m; z = 0 without a reading
    known                      (rows, columns) in and out: who is asked first has the say
    """
    for i in range(states.shape[0]):
        for j in range(states.shape[1]):
            if states[i, j] != UNKNOWN or block_points[i, j, 2] == 0.0:
                continue
            x, y, z = transform_point(
                T_other_camera, block_points[i, j, 0], block_points[i, j, 1], block_points[i, j, 2]
            )
            if z < MIN_DEPTH_M:
                continue
            u, v = project(x, y, z, intrinsics)
            states[i, j] = _classify_surface(inverse_depth, u, v, 1.0 / z)


@inline_kernel
def _classify_surface(inverse_depth: DepthBlocks, u: float, v: float, w: float) -> int:
    """What a view tells of a surface at a pixel and at 1/z of w."""
    height, width = inverse_depth.shape
    column, row = int(u + 0.5), int(v + 0.5)
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return UNKNOWN
    there = inverse_depth[row, column]
    if there <= 0.0 or there > w + MAX_SAME_SURFACE_PER_M:
        return UNKNOWN
    if there >= w - MAX_SAME_SURFACE_PER_M:
        return OBSERVED
    if not (
        EDGE_MARGIN_PX <= row < height - EDGE_MARGIN_PX
        and EDGE_MARGIN_PX <= column < width - EDGE_MARGIN_PX
    ):
        return UNKNOWN
    for dv in range(-EDGE_MARGIN_PX, EDGE_MARGIN_PX + 1, EDGE_MARGIN_PX):
        for du in range(-EDGE_MARGIN_PX, EDGE_MARGIN_PX + 1, EDGE_MARGIN_PX):
            beside = inverse_depth[row + dv, column + du]
            if not 0.0 < beside < w - MAX_SAME_SURFACE_PER_M:
                return UNKNOWN
    return FREE_SPACE


@kernel
def find_dynamic_blocks(blocks: DepthBlocks, states: BlockStates) -> NDArray[np.bool_]:
    """(rows, columns) blocks seen through, those of strange surfaces, and a rim around both."""
    rows, columns = blocks.shape
    strange = np.zeros((rows, columns), np.bool_)
    is_done = blocks <= 0.0
    surface = np.empty((rows * columns, 2), np.int64)
    for i in range(rows):
        for j in range(columns):
            if is_done[i, j]:
                continue
            size = _flood_fill_surface(blocks, is_done, i, j, surface)
            seen = through = 0
            for a, b in surface[:size]:
                seen += states[a, b] == OBSERVED
                through += states[a, b] == FREE_SPACE
            is_strange = through > seen or seen < LITTLE * size
            for a, b in surface[:size]:
                if is_strange or states[a, b] == FREE_SPACE:
                    strange[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2] = True
    return strange


@kernel
def _flood_fill_surface(
    blocks: DepthBlocks, is_visited: NDArray[np.bool_], i: int, j: int, surface: NDArray[np.int64]
) -> int:
    """Fill in the blocks of the surface that a block belongs to; how many there are."""
    rows, columns = blocks.shape
    surface[0, 0], surface[0, 1] = i, j
    is_visited[i, j] = True
    size, n = 1, 0
    while n < size:
        a, b = surface[n]
        n += 1
        for da, db in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            c, d = a + da, b + db
            if not (0 <= c < rows and 0 <= d < columns) or is_visited[c, d]:
                continue
            if abs(blocks[c, d] - blocks[a, b]) < MAX_SURFACE_STEP_PER_M:
                is_visited[c, d] = True
                surface[size, 0], surface[size, 1] = c, d
                size += 1
    return size


@kernel
def are_in_blocks(
    points: Array, intrinsics: Array, is_selected: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(N,) whether points of a keyframe lie in the blocks chosen (rows, columns)."""
    rows, columns = is_selected.shape
    is_there = np.zeros(len(points), np.bool_)
    for n in range(len(points)):
        u, v = project(points[n, 0], points[n, 1], points[n, 2], intrinsics)
        row = min(max(int(v / BLOCK_PX), 0), rows - 1)
        column = min(max(int(u / BLOCK_PX), 0), columns - 1)
        is_there[n] = is_selected[row, column]
    return is_there
