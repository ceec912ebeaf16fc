"""Scale of a motion by the known points.

Nistér, Naroditsky and Bergen, "Visual odometry", CVPR 2004; Scaramuzza and Fraundorfer, "Visual
odometry, part I", IEEE Robotics and Automation Magazine 18 (2011), Section "2-D-to-2-D".
"""

import numpy as np

from drivers.core.geometry import Array, rigid_transform
from vo_service.odometry.sfm.essential import UnscaledMotion
from vo_service.odometry.sfm.mono_frame import RayPairs
from vo_service.odometry.sfm.triangulation import triangulate

# Smallest parallax, in standard deviations, of a point that determines the scale.
MIN_PARALLAX_SIGMAS = 3.0
MIN_POINTS = 8
ITERATIONS = 6


def propose_scaled_motions(unscaled_motion: UnscaledMotion | None, pairs: RayPairs) -> list[Array]:
    """Propose motions T_camera_reference (4x4) in meters, by each method that works.

    With parallax the essential matrix gives the direction of the motion better than single points
    do. Without it (a short step, a pure rotation) it gives the rotation only.
    """
    if unscaled_motion is None:
        return []
    common = pairs.select(pairs.has_known_depth & unscaled_motion.inlier)
    if len(common) < MIN_POINTS:
        return []
    translations = (
        _scale_by_depth_ratio(unscaled_motion, common),
        _solve_translation(unscaled_motion.R, common),
    )
    return [rigid_transform(unscaled_motion.R, t) for t in translations if t is not None]


def _scale_by_depth_ratio(unscaled_motion: UnscaledMotion, common: RayPairs) -> Array | None:
    """The translation with the median length by which the points have their known depths."""
    points = triangulate(unscaled_motion.R, unscaled_motion.t, common)
    has_parallax = points.parallax_rad > MIN_PARALLAX_SIGMAS * common.sigma
    is_used = has_parallax & (points.inverse_depth > 0.0)
    if is_used.sum() < MIN_POINTS:
        return None
    length = float(np.median(points.inverse_depth[is_used] / common.inverse_depth[is_used]))
    return unscaled_motion.t * length


def _solve_translation(R: Array, common: RayPairs) -> Array:
    """(3,) translation that moves the known points to their observations, given the rotation.

    It is linear in t, with Cauchy's weights for outliers.
    """
    q = common.ray_reference @ R.T
    moved = common.ray[:, :2] * q[:, 2:] - q[:, :2]
    A = np.zeros((len(common), 2, 3))
    A[:, 0, 0] = A[:, 1, 1] = common.inverse_depth
    A[:, :, 2] = -common.inverse_depth[:, None] * common.ray[:, :2]
    t = np.zeros(3)
    for _ in range(ITERATIONS):
        error = (moved - A @ t) / common.sigma
        w = 1.0 / (1.0 + 0.25 * np.einsum("ni,ni->n", error, error))
        H = np.einsum("nij,n,nik->jk", A, w, A) + 1e-9 * np.eye(3)
        t = np.linalg.solve(H, np.einsum("nij,n,ni->j", A, w, moved))
    return t
