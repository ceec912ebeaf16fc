"""Refinement of RANSAC's consensus: fit the inliers, select them again, fit again."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.odometry.feature_points import PointPairs
from vo_service.odometry.ransac import Consensus, find_inliers, inverse_gate
from vo_service.odometry.rigid_motion import fit_rigid_motion, motion_covariance

# Number of selections of the inliers; after that they hardly change.
REFINEMENT_ITERATIONS = 3


@dataclass(frozen=True)
class RigidMotionEstimate:
    """Motion of the camera since the reference frame.

    Attributes:
        T_reference_camera: 4x4.
        inlier: (N,) bool, pairs that agree with it.
        covariance: 6x6, (translation m, rotation rad) as a small motion in the camera's axes.
    """

    T_reference_camera: Array
    inlier: NDArray[np.bool_]
    covariance: Array


def refine_rigid_motion(consensus: Consensus, pairs: PointPairs) -> RigidMotionEstimate:
    """Fit the least-squares motion of the inliers; identity with fewer than 3 inliers."""
    w = pair_weights(pairs)
    gate = inverse_gate(pairs)
    T, inlier = consensus.T_reference_camera, consensus.inlier
    for _ in range(REFINEMENT_ITERATIONS):
        if inlier.sum() < 3:
            return RigidMotionEstimate(np.eye(4), np.zeros(len(pairs), np.bool_), np.zeros((6, 6)))
        fitted = inlier
        T = fit_rigid_motion(pairs.P_camera[fitted], pairs.P_reference[fitted], w[fitted])
        inlier = find_inliers(T, pairs, gate)
    covariance = motion_covariance(pairs.P_camera[fitted], w[fitted], _sigma_m(pairs)[fitted])
    return RigidMotionEstimate(T, inlier, covariance)


def pair_weights(pairs: PointPairs) -> Array:
    """(N,) weights of the fit: the inverse variance of the distance between two points."""
    weights: Array = 1.0 / (pairs.sigma_along_m**2 + 2 * pairs.sigma_across_m**2)
    return weights


def _sigma_m(pairs: PointPairs) -> Array:
    """(N, 3) standard deviations along x, y and z of the camera, with the ray along z."""
    return np.column_stack([pairs.sigma_across_m, pairs.sigma_across_m, pairs.sigma_along_m])
