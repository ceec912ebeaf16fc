"""Bundle adjustment of a few views: the poses and points with the least reprojection error.

Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment, a modern synthesis" (2000): the
points are eliminated (Schur complement), steps are damped (Levenberg and Marquardt), errors count
by Cauchy's function.
"""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, orthonormal, rigid_transform, rotation_from_vector
from vo_service.odometry.sfm.bundle_kernels import Indices, accumulate, move_points

ROUNDS = 6
FIRST_DAMPING, LARGEST_DAMPING, SMALLEST_DAMPING = 1e-4, 1e2, 1e-9
# Enough when a step gains less than this share of the cost.
SMALLEST_GAIN = 1e-4
# Keeps a view that nothing is known of solvable.
FLOOR = 1e-3


@dataclass(frozen=True)
class Sightings:
    """Who sees what where, ordered by point.

    view    (O,) which camera
    point   (O,) which point, rising
    image   (O, 2) where, at z = 1
    sigma   standard deviation of that
    """

    view: Indices
    point: Indices
    image: Array
    sigma: float


@dataclass(frozen=True)
class Adjusted:
    """The result of an adjustment.

    T_view_world  (K, 4, 4)
    position_m    (L, 3) in the world
    covariance    (L, 3, 3) of the points, the poses being given
    squared       (O,) squared errors in standard deviations
    """

    T_view_world: Array
    position_m: Array
    covariance: Array
    squared: Array


@dataclass(frozen=True)
class _System:
    """Poses and points, their cost, and the normal equations there."""

    T: Array
    position_m: Array
    cost: float
    H: Array
    gradient: Array
    point_inverse: Array
    point_gradient: Array
    mixed: Array
    squared: Array


def adjust(T_view_world: Array, position_m: Array, sightings: Sightings) -> Adjusted:
    """The best poses (K, 4, 4) and points (L, 3); the first pose stays, the scale hardly moves."""
    damping = FIRST_DAMPING
    now = _linearise(T_view_world, position_m, sightings, damping)
    for _ in range(ROUNDS):
        then = _step(now, sightings, damping)
        if then.cost < now.cost:
            is_enough = now.cost - then.cost < SMALLEST_GAIN * now.cost
            now, damping = then, max(0.1 * damping, SMALLEST_DAMPING)
            if is_enough:
                break
        else:
            damping *= 10.0
            now = _linearise(now.T, now.position_m, sightings, damping)
            if damping > LARGEST_DAMPING:
                break
    return Adjusted(now.T, now.position_m, now.point_inverse, now.squared)


def _linearise(T: Array, position_m: Array, sightings: Sightings, damping: float) -> _System:
    views, points, seen = len(T), len(position_m), len(sightings.view)
    H, gradient = np.zeros((6 * views, 6 * views)), np.zeros(6 * views)
    inverse, of_point = np.zeros((points, 3, 3)), np.zeros((points, 3))
    mixed, squared = np.zeros((seen, 6, 3)), np.zeros(seen)
    cost = accumulate(
        T, position_m, sightings.view, sightings.point, sightings.image, sightings.sigma, damping,
        H, gradient, inverse, of_point, mixed, squared,
    )  # fmt: skip
    return _System(T, position_m, cost, H, gradient, inverse, of_point, mixed, squared)


def _step(now: _System, sightings: Sightings, damping: float) -> _System:
    """Where one damped step leads; the first view is held."""
    free = now.H[6:, 6:].copy()
    free[np.diag_indices_from(free)] *= 1.0 + damping
    free[np.diag_indices_from(free)] += FLOOR
    step = np.zeros(len(now.gradient))
    step[6:] = np.linalg.solve(free, now.gradient[6:])
    position_m = now.position_m.copy()
    move_points(
        position_m, sightings.view, sightings.point,
        now.point_inverse, now.point_gradient, now.mixed, step,
    )  # fmt: skip
    moves = [
        rigid_transform(rotation_from_vector(each[3:]), each[:3]) for each in step.reshape(-1, 6)
    ]
    T = np.array([orthonormal(move @ pose) for move, pose in zip(moves, now.T, strict=True)])
    return _linearise(T, position_m, sightings, 0.1 * damping)
