"""RANSAC on pairs of 3-D points (Fischler and Bolles 1981), and the refinement of its consensus.

Three pairs give a motion; the motion that most pairs agree with, within the sensor's noise, wins.
Its inliers are fitted and selected again.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, fit_rigid_motion, transform_points
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.features.points import PointPairs

# A pair agrees if its distance, in standard deviations of the two points, is below this.
GATE_SIGMAS = 3.0
# Errors beyond the noise model: rolling shutter, and color and depth at different times.
MODEL_ERROR_M = 0.002
# The search stops when the probability of having missed a better motion is below this.
MISS_PROBABILITY = 1e-4
# Points closer together than this constrain the rotation too little.
MIN_SIDE_M = 0.05
# Sides of two triangles that differ by this and the gates of their corners are of different shape.
SIDE_MARGIN_M = 0.01
# A triangle of less area (m^2) or side (m) is a line.
MIN_TRIANGLE = 1e-6
# Below this the corners (m^2) give no angle.
MIN_CORRELATION = 1e-12
# Number of selections of the inliers; after that they hardly change.
REFINEMENT_ITERATIONS = 3


@dataclass(frozen=True)
class Consensus:
    """The motion that most pairs agree with.

    Attributes:
        T_reference_camera: 4x4.
        inlier: (N,) bool.
    """

    T_reference_camera: Array
    inlier: NDArray[np.bool_]


def find_consensus(pairs: PointPairs, max_hypotheses: int, seed: int) -> Consensus:
    """Find the motion that most pairs agree with.

    With fewer than 3 pairs, or without a valid hypothesis, no pair is an inlier.

    Args:
        pairs: The matched points.
        max_hypotheses: Largest number of hypotheses; fewer if the inlier share is high.
        seed: Of the random numbers.
    """
    gate = inverse_gate(pairs)
    T, score = find_best_hypothesis(
        np.ascontiguousarray(pairs.P_camera.T),
        np.ascontiguousarray(pairs.P_reference.T),
        np.ascontiguousarray(gate.T),
        max_hypotheses,
        np.uint32(seed),
    )
    if score == 0.0:
        # Without a hypothesis, pairs that agree with the identity are no consensus.
        return Consensus(T, np.zeros(len(pairs), np.bool_))
    return Consensus(T, find_inliers(T, pairs, gate))


def inverse_gate(pairs: PointPairs) -> Array:
    """(N, 2): 1 / largest distance of an inlier, across the viewing ray and along it, in 1/m.

    One gate for all pairs would be too wide near the camera and too narrow far from it.
    """
    sigma_m = np.column_stack([pairs.sigma_across_m, pairs.sigma_along_m])
    gate: Array = 1.0 / (GATE_SIGMAS * sigma_m + MODEL_ERROR_M)
    return gate


def find_inliers(T_reference_camera: Array, pairs: PointPairs, gate: Array) -> NDArray[np.bool_]:
    """(N,) bool: which pairs agree with a motion; `gate` from `inverse_gate`.

    Args:
        T_reference_camera: 4x4 motion.
        pairs: Points in the camera and in the reference.
        gate: (M, 2), see `inverse_gate`.
    """
    difference = transform_points(T_reference_camera, pairs.P_camera) - pairs.P_reference
    across = (difference[:, 0] ** 2 + difference[:, 1] ** 2) * gate[:, 0] ** 2
    along = (difference[:, 2] * gate[:, 1]) ** 2
    inlier: NDArray[np.bool_] = across + along < 1.0
    return inlier


@kernel
def find_best_hypothesis(
    P: Array, Q: Array, inverse_gate: Array, max_hypotheses: int, seed: np.uint32
) -> tuple[Array, float]:
    """Find the 4x4 motion with the highest score; P, Q (3, N), inverse_gate (2, N).

    The score of a pair falls from 1 to 0 at the gate (MSAC, Torr and Zisserman 2000). Without any
    hypothesis it is 0 and the motion the identity.

    Args:
        P: (3, N) points in the camera, m.
        Q: (3, N) the same in the reference, m.
        inverse_gate: (2, N), see `inverse_gate`.
        max_hypotheses: Largest number of hypotheses.
        seed: Of the random numbers.
    """
    n = P.shape[1]
    best = np.eye(4)
    best_score = 0.0
    if n < 3:
        return best, best_score
    T = np.eye(4)
    state = np.uint32(seed * np.uint32(2) + np.uint32(1))
    hypotheses = max_hypotheses
    tried = 0
    while tried < hypotheses:
        tried += 1
        state = _next_random(state)
        i = int(state % np.uint32(n))
        state = _next_random(state)
        j = int(state % np.uint32(n))
        state = _next_random(state)
        k = int(state % np.uint32(n))
        if i in (j, k) or j == k or not _has_same_shape(P, Q, inverse_gate, i, j, k):
            continue
        if not _fit_triangles(P, Q, i, j, k, T):
            continue
        score, inliers = _score_hypothesis(P, Q, inverse_gate, T)
        if score > best_score:
            best_score = score
            for row in range(3):  # the compiler takes seconds for an assignment of slices
                for column in range(4):
                    best[row, column] = T[row, column]
            all_inlier_probability = (inliers / n) ** 3
            if all_inlier_probability >= 1.0:
                break
            needed = np.log(MISS_PROBABILITY) / np.log(1.0 - all_inlier_probability)
            hypotheses = min(max_hypotheses, int(needed) + 1)
    return best, best_score


@inline_kernel
def _next_random(state: np.uint32) -> np.uint32:
    """Marsaglia's xorshift: the same numbers on every machine."""
    state ^= np.uint32(state << np.uint32(13))
    state ^= np.uint32(state >> np.uint32(17))
    state ^= np.uint32(state << np.uint32(5))
    return np.uint32(state)


@kernel
def _has_same_shape(P: Array, Q: Array, inverse_gate: Array, i: int, j: int, k: int) -> bool:
    """Whether both triangles have equal sides, none of them too short."""
    corners = (i, j, k, i)
    for side in range(3):
        a, b = corners[side], corners[side + 1]
        p = q = 0.0
        for axis in range(3):
            p += (P[axis, a] - P[axis, b]) ** 2
            q += (Q[axis, a] - Q[axis, b]) ** 2
        p, q = np.sqrt(p), np.sqrt(q)
        tolerance = 1.0 / inverse_gate[1, a] + 1.0 / inverse_gate[1, b]
        if p < MIN_SIDE_M or abs(p - q) > tolerance + SIDE_MARGIN_M:
            return False
    return True


@kernel
def _score_hypothesis(P: Array, Q: Array, inverse_gate: Array, T: Array) -> tuple[float, int]:
    score = 0.0
    inliers = 0
    for n in range(P.shape[1]):
        dx = T[0, 0] * P[0, n] + T[0, 1] * P[1, n] + T[0, 2] * P[2, n] + T[0, 3] - Q[0, n]
        dy = T[1, 0] * P[0, n] + T[1, 1] * P[1, n] + T[1, 2] * P[2, n] + T[1, 3] - Q[1, n]
        dz = T[2, 0] * P[0, n] + T[2, 1] * P[1, n] + T[2, 2] * P[2, n] + T[2, 3] - Q[2, n]
        across, along = inverse_gate[0, n], inverse_gate[1, n]
        squared = (dx * dx + dy * dy) * across * across + dz * dz * along * along
        if squared < 1.0:
            score += 1.0 - squared
            inliers += 1
    return score, inliers


@kernel
def _fit_triangles(P: Array, Q: Array, i: int, j: int, k: int, T: Array) -> bool:
    """Fit a motion to three pairs without an SVD: plane to plane, then the angle in the plane.

    Writes the least-squares motion of the triangles into T; False if one is a line.
    """
    p_axes, p_mean, p_ok = _triangle_axes(P, i, j, k)
    q_axes, q_mean, q_ok = _triangle_axes(Q, i, j, k)
    if not (p_ok and q_ok):
        return False
    # In the triangle's own plane (axes 0 and 1) a rotation by one angle remains.
    c = s = 0.0
    for n in (i, j, k):
        pu = pv = qu = qv = 0.0
        for axis in range(3):
            p, q = P[axis, n] - p_mean[axis], Q[axis, n] - q_mean[axis]
            pu += p * p_axes[0, axis]
            pv += p * p_axes[1, axis]
            qu += q * q_axes[0, axis]
            qv += q * q_axes[1, axis]
        c += pu * qu + pv * qv
        s += pu * qv - pv * qu
    length = np.sqrt(c * c + s * s)
    if length < MIN_CORRELATION:
        return False
    c, s = c / length, s / length
    for row in range(3):
        u = c * q_axes[0, row] + s * q_axes[1, row]
        v = c * q_axes[1, row] - s * q_axes[0, row]
        T[row, 3] = q_mean[row]
        for column in range(3):
            T[row, column] = (
                u * p_axes[0, column] + v * p_axes[1, column] + q_axes[2, row] * p_axes[2, column]
            )
            T[row, 3] -= T[row, column] * p_mean[column]
    return True


@kernel
def _triangle_axes(P: Array, i: int, j: int, k: int) -> tuple[Array, Array, bool]:
    """Orthonormal axes (rows; the last is the normal), centroid, and whether it is no line."""
    axes = np.empty((3, 3))
    mean = np.empty(3)
    for axis in range(3):
        mean[axis] = (P[axis, i] + P[axis, j] + P[axis, k]) / 3.0
        axes[0, axis] = P[axis, j] - P[axis, i]
        axes[1, axis] = P[axis, k] - P[axis, i]
    nx = axes[0, 1] * axes[1, 2] - axes[0, 2] * axes[1, 1]
    ny = axes[0, 2] * axes[1, 0] - axes[0, 0] * axes[1, 2]
    nz = axes[0, 0] * axes[1, 1] - axes[0, 1] * axes[1, 0]
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    side = np.sqrt(axes[0, 0] ** 2 + axes[0, 1] ** 2 + axes[0, 2] ** 2)
    if area < MIN_TRIANGLE or side < MIN_TRIANGLE:
        return axes, mean, False
    axes[2, 0], axes[2, 1], axes[2, 2] = nx / area, ny / area, nz / area
    for axis in range(3):
        axes[0, axis] /= side
    axes[1, 0] = axes[2, 1] * axes[0, 2] - axes[2, 2] * axes[0, 1]
    axes[1, 1] = axes[2, 2] * axes[0, 0] - axes[2, 0] * axes[0, 2]
    axes[1, 2] = axes[2, 0] * axes[0, 1] - axes[2, 1] * axes[0, 0]
    return axes, mean, True


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


def motion_covariance(P: Array, w: Array, sigma_m: Array) -> Array:
    """6x6 covariance of a fitted motion, (translation m, rotation rad) in the axes of P.

    First order: the fit solves H xi = sum w_i J_i^T r_i with H = sum w_i J_i^T J_i, so
    cov(xi) = H^-1 M H^-1 with M = sum w_i^2 J_i^T diag(sigma_i^2) J_i.
    An unconstrained direction (all points on a line) gets a meter and a radian, not infinity.

    Args:
        P: (N, 3) as given to the fit.
        w: (N,) as given to the fit.
        sigma_m: (N, 3) standard deviations of T p_i - q_i in the axes of P.
    """
    J = _motion_jacobian(P)
    weighted = (J * np.sqrt(w)[:, None, None]).reshape(-1, 6)
    noise = (J * (w[:, None] * sigma_m)[:, :, None]).reshape(-1, 6)
    H_inverse = np.linalg.inv(weighted.T @ weighted + np.eye(6))
    covariance: Array = H_inverse @ (noise.T @ noise + np.eye(6)) @ H_inverse
    return 0.5 * (covariance + covariance.T)


def _motion_jacobian(P: Array) -> Array:
    """(N, 3, 6) Jacobian of a point by a small motion (rho, phi): rho + phi x p."""
    x, y, z = P.T
    J = np.zeros((len(P), 3, 6))
    J[:, :, :3] = np.eye(3)
    J[:, 0, 4], J[:, 0, 5] = z, -y
    J[:, 1, 3], J[:, 1, 5] = -z, x
    J[:, 2, 3], J[:, 2, 4] = y, -x
    return J


def pair_weights(pairs: PointPairs) -> Array:
    """(N,) weights of the fit: the inverse variance of the distance between two points."""
    weights: Array = 1.0 / (pairs.sigma_along_m**2 + 2 * pairs.sigma_across_m**2)
    return weights


def _sigma_m(pairs: PointPairs) -> Array:
    """(N, 3) standard deviations along x, y and z of the camera, with the ray along z."""
    return np.column_stack([pairs.sigma_across_m, pairs.sigma_across_m, pairs.sigma_along_m])
