"""What a new keyframe takes no points from: things that came by themselves.

Where a keyframe has seen a surface, there was nothing before it. What stands there now has moved,
and whatever follows it does not follow the room. What comes in from outside of all that was seen
cannot be told by that: it has to wait until another keyframe has seen it where it is.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, inverse
from drivers.jit import inline_kernel, kernel
from vo_service.odometry.keyframe.limits import SURFACE_STEP_PER_M
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.parameters import LITTLE
from vo_service.odometry.keyframe.readings import NEAREST_M, OTHER_SURFACE_PER_M
from vo_service.odometry.keyframe.rows import project
from vo_service.odometry.keyframe.twists import transformed

# The view is looked at in blocks of so many pixels, by the one in their middle.
BLOCK_PX, MIDDLE_PX = 8, 4
# A place is seen through if all that is so many pixels around it is further away: edges are not
# where they were by some pixels, and rows are not of one instant.
AROUND_PX = BLOCK_PX
# What others tell of a block.
UNKNOWN, SEEN, SEEN_THROUGH = 0, 1, 2

Blocks = NDArray[np.uint8]
Depths = NDArray[np.float32]


def without_strangers(keyframe: Keyframe, others: Iterable[Keyframe]) -> Keyframe:
    """A keyframe without points of surfaces that others have looked through, or never seen.

    Where others know too little of the view, it is left as it is.
    """
    images = keyframe.images
    blocks = images.inverse_depth[MIDDLE_PX::BLOCK_PX, MIDDLE_PX::BLOCK_PX].copy()
    places = _places(blocks, images.intrinsics[0])
    known = np.zeros(blocks.shape, np.uint8)
    for other in others:
        T_other_keyframe = inverse(other.T_world_keyframe) @ keyframe.T_world_keyframe
        seen = other.images
        look_from(T_other_keyframe, seen.inverse_depth, seen.intrinsics[0], places, known)
    if np.count_nonzero(known) < LITTLE * np.count_nonzero(blocks):
        return keyframe
    strange = find_strange(blocks, known)
    points = tuple(level[~is_in(level, images.intrinsics[0], strange)] for level in keyframe.points)
    return replace(keyframe, points=points)


def _places(blocks: Depths, intrinsics: Array) -> Array:
    """(rows, columns, 3) where the blocks are, in their camera's axes; 0 without a reading."""
    fx, fy, cx, cy = intrinsics
    rows, columns = np.indices(blocks.shape) * BLOCK_PX + MIDDLE_PX
    z = np.divide(1.0, blocks, out=np.zeros(blocks.shape), where=blocks > 0.0)
    return np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=-1)


@kernel
def look_from(
    T_other_camera: Array, inverse_depth: Depths, intrinsics: Array, places: Array, known: Blocks
) -> None:
    """Note what another view tells of each place that nothing is known of yet.

    inverse_depth, intrinsics  (H, W) of the other view, 1/m; 0 = no reading
    places                     (rows, columns, 3) in the camera's axes, m; z = 0 without a reading
    known                      (rows, columns) in and out: who is asked first has the say
    """
    for i in range(known.shape[0]):
        for j in range(known.shape[1]):
            if known[i, j] != UNKNOWN or places[i, j, 2] == 0.0:
                continue
            x, y, z = transformed(T_other_camera, places[i, j, 0], places[i, j, 1], places[i, j, 2])
            if z < NEAREST_M:
                continue
            u, v = project(x, y, z, intrinsics)
            known[i, j] = _tell(inverse_depth, u, v, 1.0 / z)


@inline_kernel
def _tell(inverse_depth: Depths, u: float, v: float, w: float) -> int:
    """What a view tells of a surface at a pixel and at 1/z of w."""
    height, width = inverse_depth.shape
    column, row = int(u + 0.5), int(v + 0.5)
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return UNKNOWN
    there = inverse_depth[row, column]
    if there <= 0.0 or there > w + OTHER_SURFACE_PER_M:
        return UNKNOWN
    if there >= w - OTHER_SURFACE_PER_M:
        return SEEN
    if not (AROUND_PX <= row < height - AROUND_PX and AROUND_PX <= column < width - AROUND_PX):
        return UNKNOWN
    for dv in range(-AROUND_PX, AROUND_PX + 1, AROUND_PX):
        for du in range(-AROUND_PX, AROUND_PX + 1, AROUND_PX):
            beside = inverse_depth[row + dv, column + du]
            if not 0.0 < beside < w - OTHER_SURFACE_PER_M:
                return UNKNOWN
    return SEEN_THROUGH


@kernel
def find_strange(blocks: Depths, known: Blocks) -> NDArray[np.bool_]:
    """(rows, columns) blocks seen through, those of strange surfaces, and a rim around both."""
    rows, columns = blocks.shape
    strange = np.zeros((rows, columns), np.bool_)
    is_done = blocks <= 0.0
    surface = np.empty((rows * columns, 2), np.int64)
    for i in range(rows):
        for j in range(columns):
            if is_done[i, j]:
                continue
            size = _collect(blocks, is_done, i, j, surface)
            seen = through = 0
            for a, b in surface[:size]:
                seen += known[a, b] == SEEN
                through += known[a, b] == SEEN_THROUGH
            is_strange = through > seen or seen < LITTLE * size
            for a, b in surface[:size]:
                if is_strange or known[a, b] == SEEN_THROUGH:
                    strange[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2] = True
    return strange


@kernel
def _collect(
    blocks: Depths, is_done: NDArray[np.bool_], i: int, j: int, surface: NDArray[np.int64]
) -> int:
    """Fill in the blocks of the surface that a block belongs to; how many there are."""
    rows, columns = blocks.shape
    surface[0, 0], surface[0, 1] = i, j
    is_done[i, j] = True
    size, n = 1, 0
    while n < size:
        a, b = surface[n]
        n += 1
        for da, db in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            c, d = a + da, b + db
            if not (0 <= c < rows and 0 <= d < columns) or is_done[c, d]:
                continue
            if abs(blocks[c, d] - blocks[a, b]) < SURFACE_STEP_PER_M:
                is_done[c, d] = True
                surface[size, 0], surface[size, 1] = c, d
                size += 1
    return size


@kernel
def is_in(points: Array, intrinsics: Array, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) whether points of a keyframe lie in the blocks chosen (rows, columns)."""
    rows, columns = chosen.shape
    is_there = np.zeros(len(points), np.bool_)
    for n in range(len(points)):
        u, v = project(points[n, 0], points[n, 1], points[n, 2], intrinsics)
        row = min(max(int(v / BLOCK_PX), 0), rows - 1)
        column = min(max(int(u / BLOCK_PX), 0), columns - 1)
        is_there[n] = chosen[row, column]
    return is_there
