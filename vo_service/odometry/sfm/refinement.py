"""Motion and points that project to where the features are seen: the least reprojection error.

Two views, Gauss-Newton; the points are eliminated first (Hartley and Zisserman, "Multiple View
Geometry", 2nd edition, Appendix 6), each of which has its inverse depth alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, orthonormal, rigid_transform, rotation_from_vector
from vo_service.odometry.sfm.colour_view import RayPairs
from vo_service.odometry.sfm.triangulation import triangulate

# A pair agrees if its error, in standard deviations, is below this.
GATE_SIGMAS = 3.0
ROUNDS = 8
DEPTH_ROUNDS = 3
SMALLEST_STEP = 1e-7
# Nothing is further than this, so that no inverse depth is 0, ...
SMALLEST_INVERSE_DEPTH = 1e-4
# ... nor nearer than this share of its depth in the reference.
NEAREST = 1e-6
# What the squared error of a pair is at the median if all is right: that of 2 degrees of freedom.
MEDIAN_SQUARED = 1.4


@dataclass(frozen=True)
class Refined:
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
class _Fit:
    """Points under a motion: P_camera * inverse depth, the error in the image, and its square."""

    inverse_depth: Array
    point: Array
    error: Array
    squared: Array


@dataclass(frozen=True)
class _Slopes:
    """How the projections move with the camera (M, 2, 6) and with the inverse depths (M, 2)."""

    by_motion: Array
    by_depth: Array


@dataclass(frozen=True)
class _Normal:
    """Normal equations of the motion, the points eliminated, and what gives these back."""

    H: Array
    gradient: Array
    depth_curvature: Array
    depth_gradient: Array
    mixed: Array


def refine_best(guesses: list[Array], pairs: RayPairs) -> Refined:
    """The motion that the best of the guesses, 4x4 T_camera_reference, leads to.

    The known points alone decide which, and lead nearer: without depth, pairs fit too many
    motions. Then all pairs count.
    """
    common = pairs.only(pairs.known)
    start = min(guesses, key=lambda guess: _cost(_fit_depths(guess, common)))
    return refine_motion(refine_motion(start, common).T_camera_reference, pairs)


def refine_motion(T_camera_reference: Array, pairs: RayPairs) -> Refined:
    """The best motion near a first guess, by all pairs: known points, and rays alone."""
    T = T_camera_reference
    fit = _fit_depths(T, pairs)
    for _ in range(ROUNDS):
        weight = _weights(fit)
        normal = _normal_equations(T, pairs, fit, weight)
        step = np.linalg.solve(_damped(normal.H), normal.gradient)
        by_depth = normal.depth_gradient - normal.mixed @ step
        inverse_depth = fit.inverse_depth + by_depth / normal.depth_curvature
        R_step = rotation_from_vector(step[3:])
        T = orthonormal(rigid_transform(R_step.T @ T[:3, :3], R_step.T @ (T[:3, 3] - step[:3])))
        fit = _fit(T, pairs, np.maximum(inverse_depth, SMALLEST_INVERSE_DEPTH))
        if np.abs(step).max() < SMALLEST_STEP:
            break
    slopes = _slopes(T, fit)
    by_parallax = np.einsum("ni,ni->n", slopes.by_depth, slopes.by_depth) / pairs.sigma**2
    return Refined(
        T_camera_reference=T,
        inverse_depth=fit.inverse_depth,
        information=pairs.information + by_parallax,
        inlier=fit.squared < GATE_SIGMAS**2,
        covariance=_covariance(_normal_equations(T, pairs, fit, _weights(fit)).H, fit),
        cost=_cost(fit),
    )


def _fit(T: Array, pairs: RayPairs, inverse_depth: Array) -> _Fit:
    point = pairs.ray_reference @ T[:3, :3].T + inverse_depth[:, None] * T[:3, 3]
    z = np.maximum(point[:, 2], NEAREST)
    error = pairs.ray[:, :2] - point[:, :2] / z[:, None]
    squared = np.einsum("ni,ni->n", error, error) / pairs.sigma**2
    squared += pairs.information * (inverse_depth - pairs.inverse_depth) ** 2
    squared[point[:, 2] <= NEAREST] = np.inf
    return _Fit(inverse_depth, np.column_stack([point[:, :2], z]), error, squared)


def _fit_depths(T: Array, pairs: RayPairs) -> _Fit:
    """The best inverse depth of each pair under a motion that is given."""
    found = triangulate(T[:3, :3], T[:3, 3], pairs).inverse_depth
    start = np.where(pairs.information > 0.0, pairs.inverse_depth, found)
    fit = _fit(T, pairs, np.maximum(start, SMALLEST_INVERSE_DEPTH))
    for _ in range(DEPTH_ROUNDS):
        along = _slopes(T, fit).by_depth
        curvature = np.einsum("ni,ni->n", along, along) / pairs.sigma**2 + pairs.information
        gradient = np.einsum("ni,ni->n", along, fit.error) / pairs.sigma**2
        gradient -= pairs.information * (fit.inverse_depth - pairs.inverse_depth)
        better = fit.inverse_depth + gradient / np.maximum(curvature, 1e-12)
        fit = _fit(T, pairs, np.maximum(better, SMALLEST_INVERSE_DEPTH))
    return fit


def _weights(fit: _Fit) -> Array:
    """(M,) Geman and McClure's, as wide as the errors are while the motion is still far off."""
    wide = max(1.0, float(np.median(fit.squared)) / MEDIAN_SQUARED)
    wide = wide if np.isfinite(wide) else 1e6
    weight: Array = 1.0 / (1.0 + fit.squared / (4.0 * wide)) ** 2
    return weight


def _slopes(T: Array, fit: _Fit) -> _Slopes:
    """A camera that moves by (rho, phi) sees the point y = w P at y - w rho - phi x y."""
    x, y, z = fit.point.T
    u, v, w = x / z, y / z, fit.inverse_depth
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
    return _Slopes(by_motion, by_depth)


def _normal_equations(T: Array, pairs: RayPairs, fit: _Fit, weight: Array) -> _Normal:
    slopes = _slopes(T, fit)
    of_pixel, of_prior = weight / pairs.sigma**2, weight * pairs.information
    depth_curvature = np.einsum("ni,ni->n", slopes.by_depth, slopes.by_depth) * of_pixel
    depth_curvature += of_prior + 1e-12
    depth_gradient = np.einsum("ni,ni->n", slopes.by_depth, fit.error) * of_pixel
    depth_gradient -= of_prior * (fit.inverse_depth - pairs.inverse_depth)
    mixed = np.einsum("nij,ni->nj", slopes.by_motion, slopes.by_depth) * of_pixel[:, None]
    weighted = slopes.by_motion * of_pixel[:, None, None]
    share = mixed / depth_curvature[:, None]
    H = weighted.reshape(-1, 6).T @ slopes.by_motion.reshape(-1, 6) - share.T @ mixed
    gradient = weighted.reshape(-1, 6).T @ fit.error.reshape(-1) - share.T @ depth_gradient
    return _Normal(H, gradient, depth_curvature, depth_gradient, mixed)


def _damped(H: Array) -> Array:
    """Solvable, and without effect on what the pairs tell: a metre and a radian."""
    damped: Array = H + (1.0 + 1e-6 * np.trace(H) / 6.0) * np.eye(6)
    return damped


def _covariance(H: Array, fit: _Fit) -> Array:
    """What the pairs do not tell at all is off by a metre and a radian, not by infinity.

    Where the errors are larger than expected, so is the covariance.
    """
    curvature, axes = np.linalg.eigh(0.5 * (H + H.T))
    excess = max(1.0, float(np.median(np.minimum(fit.squared, 1e6))) / MEDIAN_SQUARED)
    variance = np.minimum(excess / (np.maximum(curvature, 0.0) + 1.0), 1.0)
    covariance: Array = (axes * variance) @ axes.T
    return covariance


def _cost(fit: _Fit) -> float:
    return float(np.minimum(fit.squared, GATE_SIGMAS**2).sum())
