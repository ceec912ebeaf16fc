"""Removal of small components that float beside the surface: noise at edges, passers-by."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from vo_service.reconstruction.mesh import Mesh

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
