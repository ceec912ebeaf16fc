"""Triangle meshes: removal of small components, and PLY files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.core.files import atomic_write
from drivers.core.jit import kernel


@dataclass(frozen=True)
class Mesh:
    """A surface in the world frame of the poses.

    Attributes:
        vertices_m: (N, 3) float32.
        normals: (N, 3) float32 unit vectors, towards the side that the camera saw.
        colors_rgb: (N, 3) uint8.
        triangles: (M, 3) int32 indices of vertices, counterclockwise from the side of the normals.
    """

    vertices_m: NDArray[np.float32]
    normals: NDArray[np.float32]
    colors_rgb: NDArray[np.uint8]
    triangles: NDArray[np.int32]

    @classmethod
    def empty(cls) -> Self:
        """Make a mesh without vertices."""
        return cls(
            np.empty((0, 3), np.float32),
            np.empty((0, 3), np.float32),
            np.empty((0, 3), np.uint8),
            np.empty((0, 3), np.int32),
        )


Indices = NDArray[np.int32]


def remove_small_components(mesh: Mesh, min_triangles: int) -> Mesh:
    """Remove the connected components with fewer than `min_triangles` triangles."""
    if not len(mesh.triangles):
        return mesh
    component = np.arange(len(mesh.vertices_m), dtype=np.int32)
    _label_components(mesh.triangles, component)
    sizes = np.bincount(component[mesh.triangles[:, 0]], minlength=len(component))
    is_kept = sizes[component] >= min_triangles
    new_index = np.cumsum(is_kept, dtype=np.int32) - np.int32(1)
    triangles = mesh.triangles[is_kept[mesh.triangles[:, 0]]]
    return Mesh(
        mesh.vertices_m[is_kept],
        mesh.normals[is_kept],
        mesh.colors_rgb[is_kept],
        new_index[triangles],
    )


@kernel
def _label_components(triangles: Indices, parent: Indices) -> None:
    """Set `parent` (N,), initially each vertex itself, to the least vertex of its component."""
    for t in range(len(triangles)):
        first = _find_root(triangles[t, 0], parent)
        for corner in range(1, 3):
            other = _find_root(triangles[t, corner], parent)
            low, high = min(first, other), max(first, other)
            parent[high] = low
            first = low
    for vertex in range(len(parent)):
        parent[vertex] = _find_root(vertex, parent)


@kernel
def _find_root(vertex: int, parent: Indices) -> int:
    """Find the end of the chain of parents, and shorten the chain."""
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]
        vertex = parent[vertex]
    return vertex


_VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])
_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
_HEADER = """\
ply
format binary_little_endian 1.0
comment metres
element vertex {vertices}
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face {faces}
property list uchar int vertex_indices
end_header
"""


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write the mesh atomically.

    Raises:
        OSError: If that fails.
    """
    vertices = np.empty(len(mesh.vertices_m), _VERTEX)
    vertices["position"] = mesh.vertices_m
    vertices["normal"] = mesh.normals
    vertices["color"] = mesh.colors_rgb
    faces = np.empty(len(mesh.triangles), _FACE)
    faces["count"] = 3
    faces["vertices"] = mesh.triangles
    header = _HEADER.format(vertices=len(vertices), faces=len(faces))
    atomic_write(path, header.encode() + vertices.tobytes() + faces.tobytes())
