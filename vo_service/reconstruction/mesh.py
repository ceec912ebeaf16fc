"""A colored surface made of triangles."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray


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
