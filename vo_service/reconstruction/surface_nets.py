"""Extraction of the zero level set as a mesh, with surface nets.

Gibson, "Constrained elastic surface nets", MICCAI 1998, without relaxation. Each cell of 2 x 2 x 2
voxels that the surface crosses has one vertex, the mean of the crossings of the cell's edges. The
four cells around a crossed edge form a quad.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.voxel_block_grid import (
    BLOCK_SIDE,
    NO_BLOCK,
    VOXELS_PER_BLOCK,
    BlockCoordinates,
    VoxelBlockGrid,
    block_index,
)

# Memory of the extraction per block: the vertex number of each cell, and the vertices and triangles
# of a typical block.
MESH_BYTES_PER_BLOCK = VOXELS_PER_BLOCK * 4 + 4000

NO_VERTEX = -1
# Corner c of a cell is at (c >> 2, c >> 1 & 1, c & 1); an edge joins c and c with one more bit.
CORNERS = 8
# For an edge along x, y or z: backward offsets of the four cells around it, counterclockwise seen
# from the edge's far end.
EDGE_CELL_OFFSETS = np.array(
    [
        [[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]],
        [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    ]
)

Floats = NDArray[np.float32]
Cells = NDArray[np.int32]
HashTable = NDArray[np.int64]


def extract_surface(blocks: VoxelBlockGrid, voxel_m: float, min_weight: float) -> Mesh:
    """Extract the mesh of all voxels with at least a given weight.

    Args:
        min_weight: Least weight.
    """
    n = blocks.count
    coordinates, distance_m = blocks.coordinates[:n], blocks.distance_m[:n]
    weight, color = blocks.weight[:n], blocks.color[:n]
    cells, count = _number_vertices(coordinates, blocks.hash_table, distance_m, weight, min_weight)
    vertices_m, normals, colors_rgb = _compute_vertices(
        coordinates, blocks.hash_table, distance_m, color, cells, count, voxel_m
    )
    arrays = coordinates, blocks.hash_table, distance_m, cells
    triangles = np.empty((_emit_triangles(*arrays, np.empty((0, 3), np.int32)), 3), np.int32)
    _emit_triangles(*arrays, triangles)
    return Mesh(vertices_m, normals, colors_rgb, triangles)


@kernel
def _neighbor_blocks(
    b: int, sign: int, coordinates: BlockCoordinates, table: HashTable
) -> NDArray[np.int64]:
    """List block b and its neighbors (8,), towards `sign` along the axes whose bits are set."""
    blocks = np.empty(8, np.int64)
    for n in range(8):
        x = coordinates[b, 0] + sign * (n >> 2)
        y = coordinates[b, 1] + sign * (n >> 1 & 1)
        z = coordinates[b, 2] + sign * (n & 1)
        blocks[n] = block_index(x, y, z, table)
    return blocks


@inline_kernel
def _neighbor_index(i: int, j: int, k: int) -> int:
    """Return which of `_neighbor_blocks` holds a voxel; its indices may exceed the block by one."""
    return ((i >> 3 & 1) << 2) | ((j >> 3 & 1) << 1) | (k >> 3 & 1)


@inline_kernel
def _voxel_index(i: int, j: int, k: int) -> int:
    """Return the voxel's number within that block."""
    return ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)


@kernel
def _number_vertices(
    coordinates: BlockCoordinates,
    table: HashTable,
    distance_m: Floats,
    weight: Floats,
    min_weight: float,
) -> tuple[Cells, int]:
    """Number the vertex of the cell at each voxel (N, 512); also return the count."""
    cells = np.full((len(coordinates), VOXELS_PER_BLOCK), NO_VERTEX, np.int32)
    count = 0
    for b in range(len(coordinates)):
        around = _neighbor_blocks(b, 1, coordinates, table)
        for voxel in range(VOXELS_PER_BLOCK):
            i, j, k = voxel >> 6, voxel >> 3 & 7, voxel & 7
            behind = 0
            for c in range(CORNERS):
                ci, cj, ck = i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)
                block = around[_neighbor_index(ci, cj, ck)]
                if block == NO_BLOCK:
                    break
                corner = _voxel_index(ci, cj, ck)
                if weight[block, corner] < min_weight:
                    break
                behind += distance_m[block, corner] < 0.0
            else:
                if 0 < behind < CORNERS:
                    cells[b, voxel] = count
                    count += 1
    return cells, count


@kernel
def _compute_vertices(
    coordinates: BlockCoordinates,
    table: HashTable,
    distance_m: Floats,
    color: NDArray[np.uint16],
    cells: Cells,
    count: int,
    voxel_m: float,
) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """Compute position, normal and color of every vertex."""
    vertices_m = np.empty((count, 3), np.float32)
    normals = np.empty((count, 3), np.float32)
    colors_rgb = np.empty((count, 3), np.uint8)
    distances = np.empty(CORNERS)
    colors = np.empty((CORNERS, 3))
    for b in range(len(coordinates)):
        around = _neighbor_blocks(b, 1, coordinates, table)
        for voxel in range(VOXELS_PER_BLOCK):
            vertex = cells[b, voxel]
            if vertex == NO_VERTEX:
                continue
            i, j, k = voxel >> 6, voxel >> 3 & 7, voxel & 7
            for c in range(CORNERS):
                ci, cj, ck = i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)
                block, corner = around[_neighbor_index(ci, cj, ck)], _voxel_index(ci, cj, ck)
                distances[c] = distance_m[block, corner]
                for channel in range(3):
                    colors[c, channel] = color[block, corner, channel]
            offset, mean_color = _mean_crossing(distances, colors)
            normal = _gradient(distances)
            first = (i, j, k)
            for axis in range(3):
                begin = coordinates[b, axis] * BLOCK_SIDE + first[axis]
                vertices_m[vertex, axis] = (begin + offset[axis]) * voxel_m
                normals[vertex, axis] = normal[axis]
                colors_rgb[vertex, axis] = np.uint8(min(255.0, mean_color[axis] / 256.0 + 0.5))
    return vertices_m, normals, colors_rgb


@kernel
def _mean_crossing(distances: Array, colors: Array) -> tuple[Array, Array]:
    """Average the crossings of the cell's edges, in voxels, and the colors there."""
    offset, color = np.zeros(3), np.zeros(3)
    crossings = 0
    for c in range(CORNERS):
        for axis in range(3):
            other = c | (4 >> axis)
            if other == c or (distances[c] < 0.0) == (distances[other] < 0.0):
                continue
            along = distances[c] / (distances[c] - distances[other])
            offset[0] += c >> 2
            offset[1] += c >> 1 & 1
            offset[2] += c & 1
            offset[axis] += along
            color += (1.0 - along) * colors[c] + along * colors[other]
            crossings += 1
    return offset / crossings, color / crossings


@kernel
def _gradient(distances: Array) -> Array:
    """Compute the unit gradient of the distance: the normal, towards the camera's side."""
    gradient = np.zeros(3)
    for c in range(CORNERS):
        for axis in range(3):
            gradient[axis] += distances[c] if c & (4 >> axis) else -distances[c]
    length = np.sqrt(np.sum(gradient * gradient))
    return gradient / length if length > 0.0 else np.array([0.0, 0.0, 1.0])


@kernel
def _emit_triangles(
    coordinates: BlockCoordinates,
    table: HashTable,
    distance_m: Floats,
    cells: Cells,
    triangles: NDArray[np.int32],
) -> int:
    """Write two triangles for each crossed edge, as far as they fit; return the number of all."""
    n = 0
    quad = np.empty(4, np.int32)
    for b in range(len(coordinates)):
        before = _neighbor_blocks(b, -1, coordinates, table)
        after = _neighbor_blocks(b, 1, coordinates, table)
        for voxel in range(VOXELS_PER_BLOCK):
            if cells[b, voxel] == NO_VERTEX:
                continue
            i, j, k = voxel >> 6, voxel >> 3 & 7, voxel & 7
            is_behind = distance_m[b, voxel] < 0.0
            for axis in range(3):
                ni, nj, nk = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                far = distance_m[after[_neighbor_index(ni, nj, nk)], _voxel_index(ni, nj, nk)]
                if is_behind == (far < 0.0):
                    continue
                is_whole = True
                for corner in range(4):
                    ci, cj, ck = (
                        i - EDGE_CELL_OFFSETS[axis, corner, 0],
                        j - EDGE_CELL_OFFSETS[axis, corner, 1],
                        k - EDGE_CELL_OFFSETS[axis, corner, 2],
                    )
                    block = before[_neighbor_index(ci, cj, ck)]
                    quad[corner] = (
                        NO_VERTEX if block == NO_BLOCK else cells[block, _voxel_index(ci, cj, ck)]
                    )
                    is_whole = is_whole and quad[corner] != NO_VERTEX
                if not is_whole:
                    continue
                if n + 2 <= len(triangles):
                    a, c = (1, 3) if is_behind else (3, 1)
                    _set_triangle(triangles, n, quad[0], quad[a], quad[2])
                    _set_triangle(triangles, n + 1, quad[0], quad[2], quad[c])
                n += 2
    return n


@inline_kernel
def _set_triangle(triangles: NDArray[np.int32], n: int, a: int, b: int, c: int) -> None:
    triangles[n, 0], triangles[n, 1], triangles[n, 2] = a, b, c
