"""Writer of a mesh as a binary PLY file."""

from pathlib import Path

import numpy as np

from drivers.core.files import atomic_write
from vo_service.reconstruction.mesh import Mesh

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
