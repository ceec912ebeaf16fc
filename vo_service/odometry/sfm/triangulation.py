"""Triangulation of points as inverse depths along the rays of the reference.

Inverse depth is used, as its error is about Gaussian down to no parallax at all (Civera, Davison
and Montiel, "Inverse Depth Parametrization for Monocular SLAM", T-RO 24, 2008).
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.sfm.mono_frame import RayPairs


@dataclass(frozen=True)
class TriangulatedPoints:
    """Points triangulated by a motion between two views.

    Attributes:
        inverse_depth: (M,) in the reference; negative where the rays meet behind a camera.
        parallax_rad: (M,) approximate angle between the rays at the point.
    """

    inverse_depth: Array
    parallax_rad: Array


def triangulate(R: Array, t: Array, pairs: RayPairs) -> TriangulatedPoints:
    """Triangulate by least squares in the camera's image, with P_camera = R P_reference + t.

    With q = R ray_reference and inverse depth w the point is (q + w t) / w. The camera's ray
    (x, y, 1) gives the equation w (t_xy - t_z (x, y)) = q_z (x, y) - q_xy.

    Args:
        R: 3x3 rotation from the reference's axes to the camera's.
        t: (3,) translation.
        pairs: Rays in the camera and in the reference.
    """
    q = pairs.ray_reference @ R.T
    along = t[:2] - pairs.ray[:, :2] * t[2]
    moved = pairs.ray[:, :2] * q[:, 2:] - q[:, :2]
    squared = np.einsum("ni,ni->n", along, along)
    inverse_depth = np.einsum("ni,ni->n", along, moved) / np.maximum(squared, 1e-18)
    is_behind = q[:, 2] + inverse_depth * t[2] <= 0.0
    inverse_depth[is_behind] = -1.0
    parallax_rad = np.arctan(np.abs(inverse_depth) * np.sqrt(squared))
    parallax_rad[is_behind] = 0.0
    return TriangulatedPoints(inverse_depth, parallax_rad)
