"""Refinement of a motion and its points by the reprojection error.

Two views, Gauss-Newton; the points, whose only unknown is the inverse depth, are eliminated
(Hartley and Zisserman, "Multiple View Geometry", 2nd edition, Appendix 6).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, orthonormalize, rigid_transform, so3_exp
from vo_service.odometry.sfm.essential import triangulate
from vo_service.odometry.sfm.mono_frame import RayPairs

# A pair agrees if its error, in standard deviations, is below this.
GATE_SIGMAS = 3.0
MAX_ITERATIONS = 8
DEPTH_ITERATIONS = 3
MIN_STEP_SIZE = 1e-7
# No inverse depth is 0.
MIN_INVERSE_DEPTH_PER_M = 1e-4
# Smallest depth in the camera as a share of that in the reference.
MIN_DEPTH_RATIO = 1e-6
# Median of a squared error with 2 degrees of freedom.
EXPECTED_MEDIAN_SQUARED_ERROR = 1.4


@dataclass(frozen=True)
class TwoViewEstimate:
    """A motion and its points.

    Attributes:
        T_camera_reference: 4x4.
        inverse_depth: (M,) in the reference, 1/m.
        information: (M,) 1 / variance of the inverse depth, given the motion.
        inlier: (M,) bool, pairs that agree.
        covariance: 6x6 of the motion, (translation m, rotation rad), as a small motion in the
            camera's axes.
        cost: Sum of the squared errors, each limited to the gate.
    """

    T_camera_reference: Array
    inverse_depth: Array
    information: Array
    inlier: NDArray[np.bool_]
    covariance: Array
    cost: float


@dataclass(frozen=True)
class _TwoViewResiduals:
    """Points under a motion: P_camera * inverse depth, the error in the image, and its square."""

    inverse_depth: Array
    point: Array
    error: Array
    squared_error: Array


@dataclass(frozen=True)
class _TwoViewJacobians:
    """Jacobians of the projections by the motion (M, 2, 6) and by the inverse depths (M, 2)."""

    by_motion: Array
    by_depth: Array


@dataclass(frozen=True)
class _TwoViewNormalEquations:
    """Normal equations of the motion with the points eliminated, and the terms to recover them."""

    H: Array
    gradient: Array
    depth_curvature: Array
    depth_gradient: Array
    mixed: Array


def refine_best_guess(guesses: list[Array], pairs: RayPairs) -> TwoViewEstimate:
    """Refine the best of the guesses, 4x4 T_camera_reference.

    Only the known points select and first refine it, as pairs without depth fit too many
    motions. Then all pairs are used.
    """
    common = pairs.select(pairs.has_known_depth)
    start = min(guesses, key=lambda guess: _cost(_fit_depths(guess, common)))
    return refine_two_view(refine_two_view(start, common).T_camera_reference, pairs)


def refine_two_view(T_camera_reference: Array, pairs: RayPairs) -> TwoViewEstimate:
    """Refine a motion by all pairs, with and without known depth."""
    T = T_camera_reference
    residuals = _fit_depths(T, pairs)
    for _ in range(MAX_ITERATIONS):
        weight = _robust_weights(residuals)
        normal = _normal_equations(T, pairs, residuals, weight)
        step = np.linalg.solve(_regularize(normal.H), normal.gradient)
        by_depth = normal.depth_gradient - normal.mixed @ step
        inverse_depth = residuals.inverse_depth + by_depth / normal.depth_curvature
        R_step = so3_exp(step[3:])
        T = orthonormalize(rigid_transform(R_step.T @ T[:3, :3], R_step.T @ (T[:3, 3] - step[:3])))
        residuals = _compute_residuals(T, pairs, np.maximum(inverse_depth, MIN_INVERSE_DEPTH_PER_M))
        if np.abs(step).max() < MIN_STEP_SIZE:
            break
    jacobians = _jacobians(T, residuals)
    depth_information = (
        np.einsum("ni,ni->n", jacobians.by_depth, jacobians.by_depth) / pairs.sigma**2
    )
    return TwoViewEstimate(
        T_camera_reference=T,
        inverse_depth=residuals.inverse_depth,
        information=pairs.information + depth_information,
        inlier=residuals.squared_error < GATE_SIGMAS**2,
        covariance=_covariance(
            _normal_equations(T, pairs, residuals, _robust_weights(residuals)).H, residuals
        ),
        cost=_cost(residuals),
    )


def _compute_residuals(T: Array, pairs: RayPairs, inverse_depth: Array) -> _TwoViewResiduals:
    point = pairs.ray_reference @ T[:3, :3].T + inverse_depth[:, None] * T[:3, 3]
    z = np.maximum(point[:, 2], MIN_DEPTH_RATIO)
    error = pairs.ray[:, :2] - point[:, :2] / z[:, None]
    squared = np.einsum("ni,ni->n", error, error) / pairs.sigma**2
    squared += pairs.information * (inverse_depth - pairs.inverse_depth) ** 2
    squared[point[:, 2] <= MIN_DEPTH_RATIO] = np.inf
    return _TwoViewResiduals(inverse_depth, np.column_stack([point[:, :2], z]), error, squared)


def _fit_depths(T: Array, pairs: RayPairs) -> _TwoViewResiduals:
    """Optimize the inverse depth of each pair for a given motion."""
    triangulated = triangulate(T[:3, :3], T[:3, 3], pairs).inverse_depth
    start = np.where(pairs.information > 0.0, pairs.inverse_depth, triangulated)
    residuals = _compute_residuals(T, pairs, np.maximum(start, MIN_INVERSE_DEPTH_PER_M))
    for _ in range(DEPTH_ITERATIONS):
        along = _jacobians(T, residuals).by_depth
        curvature = np.einsum("ni,ni->n", along, along) / pairs.sigma**2 + pairs.information
        gradient = np.einsum("ni,ni->n", along, residuals.error) / pairs.sigma**2
        gradient -= pairs.information * (residuals.inverse_depth - pairs.inverse_depth)
        updated = residuals.inverse_depth + gradient / np.maximum(curvature, 1e-12)
        residuals = _compute_residuals(T, pairs, np.maximum(updated, MIN_INVERSE_DEPTH_PER_M))
    return residuals


def _robust_weights(residuals: _TwoViewResiduals) -> Array:
    """(M,) Geman and McClure's weights, scaled to the errors while the motion is inaccurate."""
    scale = max(1.0, float(np.median(residuals.squared_error)) / EXPECTED_MEDIAN_SQUARED_ERROR)
    scale = scale if np.isfinite(scale) else 1e6
    weight: Array = 1.0 / (1.0 + residuals.squared_error / (4.0 * scale)) ** 2
    return weight


def _jacobians(T: Array, residuals: _TwoViewResiduals) -> _TwoViewJacobians:
    """A camera that moves by (rho, phi) sees the point y = w P at y - w rho - phi x y."""
    x, y, z = residuals.point.T
    u, v, w = x / z, y / z, residuals.inverse_depth
    zero, one = np.zeros_like(x), np.ones_like(x)
    by_motion = np.stack(
        [
            np.stack([-w / z, zero, w * u / z, u * v, -one - u * u, v], axis=1),
            np.stack([zero, -w / z, w * v / z, one + v * v, -u * v, -u], axis=1),
        ],
        axis=1,
    )
    t = T[:3, 3]
    by_depth = np.column_stack([(t[0] - u * t[2]) / z, (t[1] - v * t[2]) / z])
    return _TwoViewJacobians(by_motion, by_depth)


def _normal_equations(
    T: Array, pairs: RayPairs, residuals: _TwoViewResiduals, weight: Array
) -> _TwoViewNormalEquations:
    jacobians = _jacobians(T, residuals)
    pixel_weight, prior_weight = weight / pairs.sigma**2, weight * pairs.information
    depth_curvature = np.einsum("ni,ni->n", jacobians.by_depth, jacobians.by_depth) * pixel_weight
    depth_curvature += prior_weight + 1e-12
    depth_gradient = np.einsum("ni,ni->n", jacobians.by_depth, residuals.error) * pixel_weight
    depth_gradient -= prior_weight * (residuals.inverse_depth - pairs.inverse_depth)
    mixed = np.einsum("nij,ni->nj", jacobians.by_motion, jacobians.by_depth) * pixel_weight[:, None]
    weighted = jacobians.by_motion * pixel_weight[:, None, None]
    gain = mixed / depth_curvature[:, None]
    H = weighted.reshape(-1, 6).T @ jacobians.by_motion.reshape(-1, 6) - gain.T @ mixed
    gradient = weighted.reshape(-1, 6).T @ residuals.error.reshape(-1) - gain.T @ depth_gradient
    return _TwoViewNormalEquations(H, gradient, depth_curvature, depth_gradient, mixed)


def _regularize(H: Array) -> Array:
    """Make H solvable by a weak prior: a meter and a radian."""
    damped: Array = H + (1.0 + 1e-6 * np.trace(H) / 6.0) * np.eye(6)
    return damped


def _covariance(H: Array, residuals: _TwoViewResiduals) -> Array:
    """6x6 of the motion; an unconstrained direction gets a meter and a radian, not infinity.

    It is larger if the errors are larger than expected.
    """
    curvature, axes = np.linalg.eigh(0.5 * (H + H.T))
    excess = max(
        1.0,
        float(np.median(np.minimum(residuals.squared_error, 1e6))) / EXPECTED_MEDIAN_SQUARED_ERROR,
    )
    variance = np.minimum(excess / (np.maximum(curvature, 0.0) + 1.0), 1.0)
    covariance: Array = (axes * variance) @ axes.T
    return covariance


def _cost(residuals: _TwoViewResiduals) -> float:
    return float(np.minimum(residuals.squared_error, GATE_SIGMAS**2).sum())
