"""Motion and points that project to where the features are seen: the least reprojection error.

Two views, Gauss-Newton; the points are eliminated first (Hartley and Zisserman, "Multiple View
Geometry", 2nd edition, Appendix 6), each of which has its inverse depth alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, orthonormalize, rigid_transform, so3_exp
from vo_service.odometry.sfm.mono_frame import RayPairs
from vo_service.odometry.sfm.triangulation import triangulate

# A pair agrees if its error, in standard deviations, is below this.
GATE_SIGMAS = 3.0
MAX_ITERATIONS = 8
DEPTH_ITERATIONS = 3
MIN_STEP_SIZE = 1e-7
# Nothing is further than this, so that no inverse depth is 0, ...
MIN_INVERSE_DEPTH_PER_M = 1e-4
# ... nor nearer than this share of its depth in the reference.
MIN_DEPTH_RATIO = 1e-6
# What the squared error of a pair is at the median if all is right: that of 2 degrees of freedom.
EXPECTED_MEDIAN_SQUARED_ERROR = 1.4


@dataclass(frozen=True)
class TwoViewEstimate:
    """A motion, and the points that go with it.

    T_camera_reference  4x4
    inverse_depth       (M,) in the reference, 1/m
    information         (M,) 1 / variance of the inverse depth, the motion being given
    inlier              (M,) bool, pairs that agree
    covariance          6x6 of the motion, (translation m, rotation rad), as a small motion in the
                        camera's axes
    cost                sum over the pairs of the squared error, none counting beyond the gate
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
    """How the projections move with the camera (M, 2, 6) and with the inverse depths (M, 2)."""

    by_motion: Array
    by_depth: Array


@dataclass(frozen=True)
class _TwoViewNormalEquations:
    """Normal equations of the motion, the points eliminated, and what gives these back."""

    H: Array
    gradient: Array
    depth_curvature: Array
    depth_gradient: Array
    mixed: Array


def refine_best_guess(guesses: list[Array], pairs: RayPairs) -> TwoViewEstimate:
    """The motion that the best of the guesses, 4x4 T_camera_reference, leads to.

    The known points alone decide which, and lead nearer: without depth, pairs fit too many
    motions. Then all pairs count.
    """
    common = pairs.select(pairs.has_known_depth)
    start = min(guesses, key=lambda guess: _cost(_fit_depths(guess, common)))
    return refine_two_view(refine_two_view(start, common).T_camera_reference, pairs)


def refine_two_view(T_camera_reference: Array, pairs: RayPairs) -> TwoViewEstimate:
    """The best motion near a first guess, by all pairs: known points, and rays alone."""
    T = T_camera_reference
    fit = _fit_depths(T, pairs)
    for _ in range(MAX_ITERATIONS):
        weight = _robust_weights(fit)
        normal = _normal_equations(T, pairs, fit, weight)
        step = np.linalg.solve(_regularize(normal.H), normal.gradient)
        by_depth = normal.depth_gradient - normal.mixed @ step
        inverse_depth = fit.inverse_depth + by_depth / normal.depth_curvature
        R_step = so3_exp(step[3:])
        T = orthonormalize(rigid_transform(R_step.T @ T[:3, :3], R_step.T @ (T[:3, 3] - step[:3])))
        fit = _compute_residuals(T, pairs, np.maximum(inverse_depth, MIN_INVERSE_DEPTH_PER_M))
        if np.abs(step).max() < MIN_STEP_SIZE:
            break
    slopes = _jacobians(T, fit)
    by_parallax = np.einsum("ni,ni->n", slopes.by_depth, slopes.by_depth) / pairs.sigma**2
    return TwoViewEstimate(
        T_camera_reference=T,
        inverse_depth=fit.inverse_depth,
        information=pairs.information + by_parallax,
        inlier=fit.squared_error < GATE_SIGMAS**2,
        covariance=_covariance(_normal_equations(T, pairs, fit, _robust_weights(fit)).H, fit),
        cost=_cost(fit),
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
    """The best inverse depth of each pair under a motion that is given."""
    found = triangulate(T[:3, :3], T[:3, 3], pairs).inverse_depth
    start = np.where(pairs.information > 0.0, pairs.inverse_depth, found)
    fit = _compute_residuals(T, pairs, np.maximum(start, MIN_INVERSE_DEPTH_PER_M))
    for _ in range(DEPTH_ITERATIONS):
        along = _jacobians(T, fit).by_depth
        curvature = np.einsum("ni,ni->n", along, along) / pairs.sigma**2 + pairs.information
        gradient = np.einsum("ni,ni->n", along, fit.error) / pairs.sigma**2
        gradient -= pairs.information * (fit.inverse_depth - pairs.inverse_depth)
        better = fit.inverse_depth + gradient / np.maximum(curvature, 1e-12)
        fit = _compute_residuals(T, pairs, np.maximum(better, MIN_INVERSE_DEPTH_PER_M))
    return fit


def _robust_weights(residuals: _TwoViewResiduals) -> Array:
    """(M,) Geman and McClure's, as wide as the errors are while the motion is still far off."""
    wide = max(1.0, float(np.median(residuals.squared_error)) / EXPECTED_MEDIAN_SQUARED_ERROR)
    wide = wide if np.isfinite(wide) else 1e6
    weight: Array = 1.0 / (1.0 + residuals.squared_error / (4.0 * wide)) ** 2
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
    slopes = _jacobians(T, residuals)
    of_pixel, of_prior = weight / pairs.sigma**2, weight * pairs.information
    depth_curvature = np.einsum("ni,ni->n", slopes.by_depth, slopes.by_depth) * of_pixel
    depth_curvature += of_prior + 1e-12
    depth_gradient = np.einsum("ni,ni->n", slopes.by_depth, residuals.error) * of_pixel
    depth_gradient -= of_prior * (residuals.inverse_depth - pairs.inverse_depth)
    mixed = np.einsum("nij,ni->nj", slopes.by_motion, slopes.by_depth) * of_pixel[:, None]
    weighted = slopes.by_motion * of_pixel[:, None, None]
    share = mixed / depth_curvature[:, None]
    H = weighted.reshape(-1, 6).T @ slopes.by_motion.reshape(-1, 6) - share.T @ mixed
    gradient = weighted.reshape(-1, 6).T @ residuals.error.reshape(-1) - share.T @ depth_gradient
    return _TwoViewNormalEquations(H, gradient, depth_curvature, depth_gradient, mixed)


def _regularize(H: Array) -> Array:
    """Solvable, and without effect on what the pairs tell: a metre and a radian."""
    damped: Array = H + (1.0 + 1e-6 * np.trace(H) / 6.0) * np.eye(6)
    return damped


def _covariance(H: Array, residuals: _TwoViewResiduals) -> Array:
    """What the pairs do not tell at all is off by a metre and a radian, not by infinity.

    Where the errors are larger than expected, so is the covariance.
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
