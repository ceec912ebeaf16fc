"""The surface where the distance is zero, as a mesh.

Surface nets (Gibson, "Constrained elastic surface nets", MICCAI 1998), the simple form without
relaxation: in every cell of 2 x 2 x 2 voxels that the surface passes through there is one vertex,
amid the points where it crosses the cell's edges; the four cells around an edge that is crossed
make a quad.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import inline_kernel, kernel
from vo_service.mapping.blocks import ABSENT, SIDE, VOXELS, Blocks, Coordinates, slot_of
from vo_service.mapping.mesh import Mesh

# What the mesh takes for each block while it is made: the number of every cell's vertex, and the
# vertices and triangles themselves of as many cells as there usually are.
MESH_BYTES = VOXELS * 4 + 4000

NO_VERTEX = -1
# Corner c of a cell is at (c >> 2, c >> 1 & 1, c & 1); an edge joins c and c with one more bit.
CORNERS = 8
# For an edge along x, y or z: how far back the four cells around it begin, counter-clockwise seen
# from the edge's far end.
RINGS = np.array(
    [
        [[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]],
        [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    ]
)

Floats = NDArray[np.float32]
Cells = NDArray[np.int32]
Table = NDArray[np.int64]


def surface(blocks: Blocks, voxel_m: float, least_weight: float) -> Mesh:
    """The mesh of all voxels whose weight is at least `least_weight`."""
    n = blocks.count
    coordinates, distance_m = blocks.coordinates[:n], blocks.distance_m[:n]
    weight, colour = blocks.weight[:n], blocks.colour[:n]
    cells, count = _number_vertices(coordinates, blocks.table, distance_m, weight, least_weight)
    vertices_m, normals, colours_rgb = _place_vertices(
        coordinates, blocks.table, distance_m, colour, cells, count, voxel_m
    )
    triangles = np.empty(
        (_join(coordinates, blocks.table, distance_m, cells, _none()), 3), np.int32
    )
    _join(coordinates, blocks.table, distance_m, cells, triangles)
    return Mesh(vertices_m, normals, colours_rgb, triangles)


def _none() -> NDArray[np.int32]:
    return np.empty((0, 3), np.int32)


@kernel
def _around(b: int, sign: int, coordinates: Coordinates, table: Table) -> NDArray[np.int64]:
    """(8,) block b and its neighbours, on the side of `sign` along the axes whose bits are set."""
    blocks = np.empty(8, np.int64)
    for n in range(8):
        x = coordinates[b, 0] + sign * (n >> 2)
        y = coordinates[b, 1] + sign * (n >> 1 & 1)
        z = coordinates[b, 2] + sign * (n & 1)
        blocks[n] = slot_of(x, y, z, table)
    return blocks


@inline_kernel
def _block_of(i: int, j: int, k: int) -> int:
    """Which of `_around` a voxel is in whose indices may be one out of the block."""
    return ((i >> 3 & 1) << 2) | ((j >> 3 & 1) << 1) | (k >> 3 & 1)


@inline_kernel
def _voxel_of(i: int, j: int, k: int) -> int:
    """Its number within that block."""
    return ((i & 7) << 6) | ((j & 7) << 3) | (k & 7)


@kernel
def _number_vertices(
    coordinates: Coordinates, table: Table, distance_m: Floats, weight: Floats, least_weight: float
) -> tuple[Cells, int]:
    """(N, 512) number of the vertex in the cell that begins at each voxel, and how many."""
    cells = np.full((len(coordinates), VOXELS), NO_VERTEX, np.int32)
    count = 0
    for b in range(len(coordinates)):
        around = _around(b, 1, coordinates, table)
        for voxel in range(VOXELS):
            i, j, k = voxel >> 6, voxel >> 3 & 7, voxel & 7
            behind = 0
            for c in range(CORNERS):
                ci, cj, ck = i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)
                block = around[_block_of(ci, cj, ck)]
                if block == ABSENT:
                    break
                corner = _voxel_of(ci, cj, ck)
                if weight[block, corner] < least_weight:
                    break
                behind += distance_m[block, corner] < 0.0
            else:
                if 0 < behind < CORNERS:
                    cells[b, voxel] = count
                    count += 1
    return cells, count


@kernel
def _place_vertices(
    coordinates: Coordinates,
    table: Table,
    distance_m: Floats,
    colour: NDArray[np.uint16],
    cells: Cells,
    count: int,
    voxel_m: float,
) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """Position, normal and colour of every vertex."""
    vertices_m = np.empty((count, 3), np.float32)
    normals = np.empty((count, 3), np.float32)
    colours_rgb = np.empty((count, 3), np.uint8)
    distances = np.empty(CORNERS)
    colours = np.empty((CORNERS, 3))
    for b in range(len(coordinates)):
        around = _around(b, 1, coordinates, table)
        for voxel in range(VOXELS):
            vertex = cells[b, voxel]
            if vertex == NO_VERTEX:
                continue
            i, j, k = voxel >> 6, voxel >> 3 & 7, voxel & 7
            for c in range(CORNERS):
                ci, cj, ck = i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)
                block, corner = around[_block_of(ci, cj, ck)], _voxel_of(ci, cj, ck)
                distances[c] = distance_m[block, corner]
                for channel in range(3):
                    colours[c, channel] = colour[block, corner, channel]
            place, paint = _amid_crossings(distances, colours)
            slope = _gradient(distances)
            first = (i, j, k)
            for axis in range(3):
                begin = coordinates[b, axis] * SIDE + first[axis]
                vertices_m[vertex, axis] = (begin + place[axis]) * voxel_m
                normals[vertex, axis] = slope[axis]
                colours_rgb[vertex, axis] = np.uint8(min(255.0, paint[axis] / 256.0 + 0.5))
    return vertices_m, normals, colours_rgb


@kernel
def _amid_crossings(distances: Array, colours: Array) -> tuple[Array, Array]:
    """Mean of where the surface crosses the cell's edges, in voxels, and of the colours there."""
    place, paint = np.zeros(3), np.zeros(3)
    crossings = 0
    for c in range(CORNERS):
        for axis in range(3):
            other = c | (4 >> axis)
            if other == c or (distances[c] < 0.0) == (distances[other] < 0.0):
                continue
            along = distances[c] / (distances[c] - distances[other])
            place[0] += c >> 2
            place[1] += c >> 1 & 1
            place[2] += c & 1
            place[axis] += along
            paint += (1.0 - along) * colours[c] + along * colours[other]
            crossings += 1
    return place / crossings, paint / crossings


@kernel
def _gradient(distances: Array) -> Array:
    """Where the distance grows most, of length 1: away from the surface, to where it was seen."""
    gradient = np.zeros(3)
    for c in range(CORNERS):
        for axis in range(3):
            gradient[axis] += distances[c] if c & (4 >> axis) else -distances[c]
    length = np.sqrt(np.sum(gradient * gradient))
    return gradient / length if length > 0.0 else np.array([0.0, 0.0, 1.0])


@kernel
def _join(
    coordinates: Coordinates,
    table: Table,
    distance_m: Floats,
    cells: Cells,
    triangles: NDArray[np.int32],
) -> int:
    """Two triangles for each edge that is crossed, written while there is room; how many."""
    n = 0
    quad = np.empty(4, np.int32)
    for b in range(len(coordinates)):
        before = _around(b, -1, coordinates, table)
        after = _around(b, 1, coordinates, table)
        for voxel in range(VOXELS):
            if cells[b, voxel] == NO_VERTEX:
                continue
            i, j, k = voxel >> 6, voxel >> 3 & 7, voxel & 7
            is_behind = distance_m[b, voxel] < 0.0
            for axis in range(3):
                ni, nj, nk = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                far = distance_m[after[_block_of(ni, nj, nk)], _voxel_of(ni, nj, nk)]
                if is_behind == (far < 0.0):
                    continue
                is_whole = True
                for corner in range(4):
                    ci, cj, ck = (
                        i - RINGS[axis, corner, 0],
                        j - RINGS[axis, corner, 1],
                        k - RINGS[axis, corner, 2],
                    )
                    block = before[_block_of(ci, cj, ck)]
                    quad[corner] = (
                        NO_VERTEX if block == ABSENT else cells[block, _voxel_of(ci, cj, ck)]
                    )
                    is_whole = is_whole and quad[corner] != NO_VERTEX
                if not is_whole:
                    continue
                if n + 2 <= len(triangles):
                    a, c = (1, 3) if is_behind else (3, 1)
                    _set(triangles, n, quad[0], quad[a], quad[2])
                    _set(triangles, n + 1, quad[0], quad[2], quad[c])
                n += 2
    return n


@inline_kernel
def _set(triangles: NDArray[np.int32], n: int, a: int, b: int, c: int) -> None:
    triangles[n, 0], triangles[n, 1], triangles[n, 2] = a, b, c
