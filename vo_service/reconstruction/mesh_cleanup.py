"""Specks that float beside the surface: a reading at an edge, somebody who walked by."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from vo_service.reconstruction.mesh import Mesh

Indices = NDArray[np.int32]


def remove_small_components(mesh: Mesh, min_triangles: int) -> Mesh:
    """The mesh without the connected parts that have fewer triangles than that."""
    if not len(mesh.triangles):
        return mesh
    part = np.arange(len(mesh.vertices_m), dtype=np.int32)
    _label_components(mesh.triangles, part)
    sizes = np.bincount(part[mesh.triangles[:, 0]], minlength=len(part))
    is_kept = sizes[part] >= min_triangles
    number = np.cumsum(is_kept, dtype=np.int32) - np.int32(1)
    triangles = mesh.triangles[is_kept[mesh.triangles[:, 0]]]
    return Mesh(
        mesh.vertices_m[is_kept],
        mesh.normals[is_kept],
        mesh.colors_rgb[is_kept],
        number[triangles],
    )


@kernel
def _label_components(triangles: Indices, parent: Indices) -> None:
    """Make `parent` (N,), each vertex itself at first, the least that it is connected to."""
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
    """Where the chain of parents ends; the chain is made shorter on the way."""
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]
        vertex = parent[vertex]
    return vertex
