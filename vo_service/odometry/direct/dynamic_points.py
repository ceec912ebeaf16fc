"""Removal of a keyframe's points on objects that have moved.

Where a keyframe has seen a surface, the space before it was free. An object that is there now has
moved, and points on it do not follow the room. Surfaces that no other keyframe has observed cannot
be classified; their points wait until another keyframe has observed them.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.image_pyramid import inverse_depth, surface_step
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import project, transform_point
from vo_service.odometry.direct.parameters import (
    DYNAMIC_BLOCK_PX,
    MAX_SAME_SURFACE_RATIO,
    MIN_DEPTH_M,
    MIN_OBSERVED_SHARE,
)
from vo_service.odometry.direct.points import are_in_blocks, drop_empty_levels

BLOCK_CENTER_PX = DYNAMIC_BLOCK_PX // 2
# State of a block by the views of other keyframes.
UNKNOWN, OBSERVED, FREE_SPACE = 0, 1, 2
BlockStates = NDArray[np.uint8]
DepthBlocks = NDArray[np.float32]


def remove_dynamic_points(
    keyframe: DirectKeyframe, others: Iterable[DirectKeyframe]
) -> DirectKeyframe:
    """Remove points on surfaces that are in free space of other keyframes or not observed.

    If the others have observed too little of the view, the keyframe is returned unchanged.
    """
    images = keyframe.images
    blocks, block_points = backproject_blocks(
        images.depth.raw, images.depth.factor, images.intrinsics[0]
    )
    states = np.zeros(blocks.shape, np.uint8)
    for other in others:
        T_other_keyframe = inverse(other.T_world_keyframe) @ keyframe.T_world_keyframe
        images_of_other = other.images
        classify_from_view(
            T_other_keyframe,
            images_of_other.depth.raw,
            images_of_other.depth.factor,
            images_of_other.intrinsics[0],
            images.depth_noise,
            block_points,
            states,
        )
    if np.count_nonzero(states) < MIN_OBSERVED_SHARE * np.count_nonzero(blocks):
        return keyframe
    is_dynamic_block = find_dynamic_blocks(blocks, states, images.depth_noise)
    points = drop_empty_levels(
        level.select(~are_in_blocks(level.position_m, images.intrinsics[0], is_dynamic_block))
        for level in keyframe.points
    )
    return replace(keyframe, points=points)


@kernel
def backproject_blocks(
    depth_raw: NDArray[np.uint16], depth_factor: float, intrinsics: Array
) -> tuple[DepthBlocks, Array]:
    """Inverse depth and position of the pixels in the centers of the blocks.

    Args:
        depth_raw: (H, W), 0 = no reading.
        depth_factor: Value of `depth_raw` per meter.
        intrinsics: (4,) of the whole image.

    Returns:
        (rows, columns) in 1/m, and (rows, columns, 3) in the camera's axes, m; 0 without a reading.
    """
    raw = depth_raw[BLOCK_CENTER_PX::DYNAMIC_BLOCK_PX, BLOCK_CENTER_PX::DYNAMIC_BLOCK_PX]
    rows, columns = raw.shape
    fx, fy, cx, cy = intrinsics
    blocks, points = np.zeros((rows, columns), np.float32), np.zeros((rows, columns, 3))
    for i in range(rows):
        for j in range(columns):
            if raw[i, j] == 0:
                continue
            blocks[i, j] = inverse_depth(raw[i, j], depth_factor)
            z = float(np.float32(1.0) / blocks[i, j])
            u, v = j * DYNAMIC_BLOCK_PX + BLOCK_CENTER_PX, i * DYNAMIC_BLOCK_PX + BLOCK_CENTER_PX
            points[i, j, 0], points[i, j, 1] = (u - cx) / fx * z, (v - cy) / fy * z
            points[i, j, 2] = z
    return blocks, points


@kernel
def classify_from_view(
    T_other_camera: Array,
    depth_raw: NDArray[np.uint16],
    depth_factor: float,
    intrinsics: Array,
    noise: float,
    block_points: Array,
    states: BlockStates,
) -> None:
    """Classify the blocks that are still unknown by the view of another keyframe.

    Args:
        T_other_camera: 4x4.
        depth_raw: (H, W) of the other view, 0 = no reading.
        depth_factor: Value of `depth_raw` per meter.
        intrinsics: (4,) of the other view.
        noise: Of the inverse depth of a pixel, 1/m.
        block_points: (rows, columns, 3) in the camera's axes, m; z = 0 without depth.
        states: (rows, columns), in and out: known blocks are not changed.
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
            states[i, j] = _classify_surface(depth_raw, depth_factor, u, v, 1.0 / z, noise)


@inline_kernel
def _classify_surface(
    depth_raw: NDArray[np.uint16], depth_factor: float, u: float, v: float, w: float, noise: float
) -> int:
    """State of a surface at a pixel and an inverse depth w, by a view."""
    height, width = depth_raw.shape
    column, row = int(u + 0.5), int(v + 0.5)
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return UNKNOWN
    inverse_depth_there = inverse_depth(depth_raw[row, column], depth_factor)
    tolerance = MAX_SAME_SURFACE_RATIO * surface_step(w, noise)
    if inverse_depth_there <= 0.0 or inverse_depth_there > w + tolerance:
        return UNKNOWN
    if inverse_depth_there >= w - tolerance:
        return OBSERVED
    if not (
        DYNAMIC_BLOCK_PX <= row < height - DYNAMIC_BLOCK_PX
        and DYNAMIC_BLOCK_PX <= column < width - DYNAMIC_BLOCK_PX
    ):
        return UNKNOWN
    for dv in range(-DYNAMIC_BLOCK_PX, DYNAMIC_BLOCK_PX + 1, DYNAMIC_BLOCK_PX):
        for du in range(-DYNAMIC_BLOCK_PX, DYNAMIC_BLOCK_PX + 1, DYNAMIC_BLOCK_PX):
            neighbor = inverse_depth(depth_raw[row + dv, column + du], depth_factor)
            if not 0.0 < neighbor < w - tolerance:
                return UNKNOWN
    return FREE_SPACE


@kernel
def find_dynamic_blocks(
    blocks: DepthBlocks, states: BlockStates, noise: float
) -> NDArray[np.bool_]:
    """(rows, columns) blocks in free space and of dynamic surfaces, with a margin of one block.

    Args:
        blocks: (rows, columns) inverse depth, 1/m.
        states: (rows, columns) by the views of other keyframes.
        noise: Of the inverse depth of a pixel, 1/m.
    """
    rows, columns = blocks.shape
    is_dynamic_block = np.zeros((rows, columns), np.bool_)
    is_visited = blocks <= 0.0
    surface = np.empty((rows * columns, 2), np.int64)
    for i in range(rows):
        for j in range(columns):
            if is_visited[i, j]:
                continue
            size = _flood_fill_surface(blocks, is_visited, i, j, surface, noise)
            observed = in_free_space = 0
            for a, b in surface[:size]:
                observed += states[a, b] == OBSERVED
                in_free_space += states[a, b] == FREE_SPACE
            is_dynamic_surface = in_free_space > observed or observed < MIN_OBSERVED_SHARE * size
            for a, b in surface[:size]:
                if is_dynamic_surface or states[a, b] == FREE_SPACE:
                    is_dynamic_block[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2] = True
    return is_dynamic_block


@kernel
def _flood_fill_surface(
    blocks: DepthBlocks,
    is_visited: NDArray[np.bool_],
    i: int,
    j: int,
    surface: NDArray[np.int64],
    noise: float,
) -> int:
    """Fill in the blocks of the surface that a block belongs to, and return their number."""
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
            if abs(blocks[c, d] - blocks[a, b]) < surface_step(blocks[a, b], noise):
                is_visited[c, d] = True
                surface[size, 0], surface[size, 1] = c, d
                size += 1
    return size
