"""Pairs of points with a depth camera's noise, and outliers."""

import numpy as np

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, transform_points
from vo_service.odometry.features.points import PointPairs
from vo_service.odometry.uncertainty import depth_sigma_m, lateral_sigma_m

FOCAL_PX = 520.0
T_REFERENCE_CAMERA = rigid_transform(so3_exp([0.03, -0.05, 0.02]), [0.04, -0.02, 0.06])


def sample_points(random: np.random.Generator, n: int) -> Array:
    """(n, 3) points from 0.7 to 3.5 m in front of the camera."""
    z = random.uniform(0.7, 3.5, n)
    u, v = random.uniform(-300, 300, n), random.uniform(-220, 220, n)
    return np.column_stack([u * z / FOCAL_PX, v * z / FOCAL_PX, z])


def make_exact_pairs(P_camera: Array, P_reference: Array) -> PointPairs:
    """Pairs as given, with the noise that their depth would have."""
    z = P_camera[:, 2]
    across, along = lateral_sigma_m(z, FOCAL_PX), depth_sigma_m(z)
    return PointPairs(P_camera, P_reference, np.sqrt(2) * across, np.sqrt(2) * along)


def make_noisy_pairs(seed: int, n: int, outliers: int) -> PointPairs:
    """Noisy pairs of the motion T_REFERENCE_CAMERA; the last `outliers` of them are wrong."""
    random = np.random.default_rng(seed)
    P_reference = sample_points(random, n)
    P_camera = transform_points(inverse(T_REFERENCE_CAMERA), P_reference)
    P_reference[n - outliers :] = sample_points(random, outliers)
    return make_exact_pairs(_add_noise(random, P_camera), _add_noise(random, P_reference))


def _add_noise(random: np.random.Generator, P: Array) -> Array:
    sigma_m = np.column_stack([lateral_sigma_m(P[:, 2], FOCAL_PX)] * 2 + [depth_sigma_m(P[:, 2])])
    noisy: Array = P + sigma_m * random.normal(size=P.shape)
    return noisy
