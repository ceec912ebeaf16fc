"""Rays of a point cloud in two cameras, for structure from motion."""

import numpy as np
from hypothesis import strategies as st

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, transform_points
from vo_service.odometry.sfm.mono_frame import RayPairs

SIGMA = 0.7 / 525.0
# Sideways with a rotation, as hand-held within a third of a second.
MOTION = rigid_transform(so3_exp([0.03, -0.06, 0.02]), [0.15, -0.04, 0.05])


def make_cloud(count: int = 150, seed: int = 0) -> Array:
    """Points (N, 3) within the view of a camera at the origin, 1 to 4 m away."""
    random = np.random.default_rng(seed)
    z = random.uniform(1.0, 4.0, count)
    return np.column_stack(
        [random.uniform(-0.5, 0.5, count) * z, random.uniform(-0.4, 0.4, count) * z, z]
    )


def project_rays(T_camera_world: Array, points: Array) -> Array:
    """(N, 3) with z = 1."""
    P = transform_points(T_camera_world, points)
    return P / P[:, 2:]


def make_pairs(
    T_reference_camera: Array, known_to: float = 0.0, noise: float = 0.0, count: int = 150
) -> RayPairs:
    """The cloud seen from the reference and the camera; its depth known to a share of itself.

    A share of 0: nothing is known of the depth. `noise` is that of the camera's rays.
    """
    points = make_cloud(count)
    ray = project_rays(inverse(T_reference_camera), points)
    ray[:, :2] += np.random.default_rng(1).normal(0.0, 1.0, (count, 2)) * noise
    inverse_depth, information = 1.0 / points[:, 2], np.zeros(count)
    if known_to > 0.0:
        information = points[:, 2] ** 2 / known_to**2
    return RayPairs(ray, project_rays(np.eye(4), points), inverse_depth, information, SIGMA)


def small_vectors(limit: float) -> st.SearchStrategy[Array]:
    """Vectors of three numbers up to a limit."""
    number = st.floats(-limit, limit)
    return st.tuples(number, number, number).map(np.array)
