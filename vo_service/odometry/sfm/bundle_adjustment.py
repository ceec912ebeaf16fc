"""Bundle adjustment of a few views: the poses and points with the least reprojection error.

Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment, a modern synthesis" (2000): the
points are eliminated (Schur complement), steps are damped (Levenberg and Marquardt), errors count
by Cauchy's function.
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, orthonormalize, rigid_transform, so3_exp
from vo_service.odometry.sfm.bundle_kernels import Indices, accumulate_bundle, update_points

MAX_ITERATIONS = 6
INITIAL_DAMPING, MAX_DAMPING, MIN_DAMPING = 1e-4, 1e2, 1e-9
# Enough when a step gains less than this share of the cost.
MIN_RELATIVE_GAIN = 1e-4
# Keeps a view that nothing is known of solvable.
INFORMATION_FLOOR = 1e-3


@dataclass(frozen=True)
class BundleObservations:
    """Who sees what where, ordered by point.

    view    (O,) which camera
    point   (O,) which point, rising
    image   (O, 2) where, at z = 1
    sigma   standard deviation of that
    """

    view: Indices
    point: Indices
    ray: Array
    sigma: float


@dataclass(frozen=True)
class BundleResult:
    """The result of an adjustment.

    T_view_world  (K, 4, 4)
    position_m    (L, 3) in the world
    covariance    (L, 3, 3) of the points, the poses being given
    squared       (O,) squared errors in standard deviations
    """

    T_view_world: Array
    position_m: Array
    covariance: Array
    squared_error: Array


@dataclass(frozen=True)
class _BundleSystem:
    """Poses and points, their cost, and the normal equations there."""

    T: Array
    position_m: Array
    cost: float
    H: Array
    gradient: Array
    point_inverse: Array
    point_gradient: Array
    mixed: Array
    squared_error: Array


def adjust_bundle(
    T_view_world: Array, position_m: Array, observations: BundleObservations
) -> BundleResult:
    """The best poses (K, 4, 4) and points (L, 3); the first pose stays, the scale hardly moves."""
    damping = INITIAL_DAMPING
    now = _linearize(T_view_world, position_m, observations, damping)
    for _ in range(MAX_ITERATIONS):
        then = _take_step(now, observations, damping)
        if then.cost < now.cost:
            is_enough = now.cost - then.cost < MIN_RELATIVE_GAIN * now.cost
            now, damping = then, max(0.1 * damping, MIN_DAMPING)
            if is_enough:
                break
        else:
            damping *= 10.0
            now = _linearize(now.T, now.position_m, observations, damping)
            if damping > MAX_DAMPING:
                break
    return BundleResult(now.T, now.position_m, now.point_inverse, now.squared_error)


def _linearize(
    T: Array, position_m: Array, observations: BundleObservations, damping: float
) -> _BundleSystem:
    views, points, seen = len(T), len(position_m), len(observations.view)
    H, gradient = np.zeros((6 * views, 6 * views)), np.zeros(6 * views)
    inverse, of_point = np.zeros((points, 3, 3)), np.zeros((points, 3))
    mixed, squared = np.zeros((seen, 6, 3)), np.zeros(seen)
    cost = accumulate_bundle(
        T, position_m, observations.view, observations.point, observations.ray, observations.sigma,
        damping, H, gradient, inverse, of_point, mixed, squared,
    )  # fmt: skip
    return _BundleSystem(T, position_m, cost, H, gradient, inverse, of_point, mixed, squared)


def _take_step(
    system: _BundleSystem, observations: BundleObservations, damping: float
) -> _BundleSystem:
    """Where one damped step leads; the first view is held."""
    free = system.H[6:, 6:].copy()
    free[np.diag_indices_from(free)] *= 1.0 + damping
    free[np.diag_indices_from(free)] += INFORMATION_FLOOR
    step = np.zeros(len(system.gradient))
    step[6:] = np.linalg.solve(free, system.gradient[6:])
    position_m = system.position_m.copy()
    update_points(
        position_m, observations.view, observations.point,
        system.point_inverse, system.point_gradient, system.mixed, step,
    )  # fmt: skip
    moves = [rigid_transform(so3_exp(each[3:]), each[:3]) for each in step.reshape(-1, 6)]
    T = np.array([orthonormalize(move @ pose) for move, pose in zip(moves, system.T, strict=True)])
    return _linearize(T, position_m, observations, 0.1 * damping)
