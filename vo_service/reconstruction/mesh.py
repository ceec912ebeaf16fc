"""A colored surface made of triangles."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mesh:
    """A surface, in the world that the poses were given in.

    vertices_m   (N, 3) float32
    normals      (N, 3) float32 of length 1, towards where it was seen from
    colors_rgb  (N, 3) uint8
    triangles    (M, 3) int32 indices of vertices, counter-clockwise seen from where the normals
                 point
    """

    vertices_m: NDArray[np.float32]
    normals: NDArray[np.float32]
    colors_rgb: NDArray[np.uint8]
    triangles: NDArray[np.int32]

    @classmethod
    def empty(cls) -> Self:
        """A mesh of nothing."""
        return cls(
            np.empty((0, 3), np.float32),
            np.empty((0, 3), np.float32),
            np.empty((0, 3), np.uint8),
            np.empty((0, 3), np.int32),
        )
