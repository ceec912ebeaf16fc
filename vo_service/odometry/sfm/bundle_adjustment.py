"""Bundle adjustment of a few views: the poses and points with the least reprojection error.

Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment, a modern synthesis" (2000): the
points are eliminated (Schur complement), steps are damped (Levenberg and Marquardt), and the
cost is Cauchy's function.

Observations are ordered by point; a view moves as exp(step) T_view_world, step (meters, radians).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, orthonormalize, rigid_transform, so3_exp
from drivers.core.jit import inline_kernel, kernel

# Squared error, in standard deviations, at which the weight is half.
CAUCHY_SCALE_SQUARED = 4.0
# A point with less depth is not visible.
MIN_DEPTH_M = 1e-3
UNSEEN_SQUARED_ERROR = 1e9
# Keeps the system solvable for a point without constraint.
POINT_INFORMATION_FLOOR = 1e-3

Indices = NDArray[np.int64]


class BundleObservations(NamedTuple):
    """Observations of points in views, ordered by point.

    Attributes:
        view_index: (O,) of the view.
        point_index: (O,) of the point, ascending.
        ray: (O, 2) position in the image at z = 1.
        sigma: Standard deviation of that position.
    """

    view_index: Indices
    point_index: Indices
    ray: Array
    sigma: float


class BundleEquations(NamedTuple):
    """Normal equations of K views and L points, with the points eliminated.

    Attributes:
        H: (6 K, 6 K) of the views.
        gradient: (6 K,) of the views.
        point_inverse: (L, 3, 3) inverse of each point's own matrix.
        point_gradient: (L, 3) of each point.
        mixed: (O, 6, 3) of each observation's view and point.
        squared_error: (O,) in standard deviations.
    """

    H: Array
    gradient: Array
    point_inverse: Array
    point_gradient: Array
    mixed: Array
    squared_error: Array

    @classmethod
    def zeros(cls, views: int, points: int, observations: int) -> "BundleEquations":
        """Make equations of this size, to be filled in.

        Args:
            views: Number K of views.
            points: Number L of points.
            observations: Number O of observations.
        """
        return cls(
            np.zeros((6 * views, 6 * views)),
            np.zeros(6 * views),
            np.zeros((points, 3, 3)),
            np.zeros((points, 3)),
            np.zeros((observations, 6, 3)),
            np.zeros(observations),
        )


@kernel
def accumulate_bundle(
    T: Array,
    position_m: Array,
    observations: BundleObservations,
    damping: float,
    equations: BundleEquations,
) -> float:
    """Fill in the normal equations, and return the cost.

    Args:
        T: (K, 4, 4) T_view_world.
        position_m: (L, 3) in the world frame.
        damping: Factor of Levenberg and Marquardt for the points.
        equations: Zero on entry.
    """
    view, point, ray, sigma = observations
    point_gradient = equations.point_gradient
    cost = 0.0
    begin = 0
    while begin < len(point):
        end = begin
        V = np.zeros((3, 3))
        while end < len(point) and point[end] == point[begin]:
            cost += _add_observation(
                T[view[end]],
                position_m[point[end]],
                ray[end],
                sigma,
                V,
                point_gradient[point[end]],
                equations,
                (6 * view[end], end),
            )
            end += 1
        for a in range(3):
            V[a, a] = V[a, a] * (1.0 + damping) + POINT_INFORMATION_FLOOR
        _invert_symmetric_3x3(V, equations.point_inverse[point[begin]])
        _eliminate_point(equations, view, point, begin, end)
        begin = end
    return cost


@inline_kernel
def _add_observation(
    T: Array,
    P: Array,
    ray: Array,
    sigma: float,
    V: Array,
    b: Array,
    equations: BundleEquations,
    place: tuple[int, int],
) -> float:
    """Add an observation to the equations of its view and its point, and return its cost.

    Args:
        T: 4x4 T_view_world.
        P: (3,) position of the point.
        ray: (2,) where it was observed.
        sigma: Standard deviation of that.
        V: (3, 3) matrix of the point, in and out.
        b: (3,) vector of the point, in and out.
        equations: In and out.
        place: First row of the view, and index of the observation.
    """
    row, n = place
    H, gradient = equations.H, equations.gradient
    mixed, squared = equations.mixed[n], equations.squared_error
    x = T[0, 0] * P[0] + T[0, 1] * P[1] + T[0, 2] * P[2] + T[0, 3]
    y = T[1, 0] * P[0] + T[1, 1] * P[1] + T[1, 2] * P[2] + T[1, 3]
    z = T[2, 0] * P[0] + T[2, 1] * P[1] + T[2, 2] * P[2] + T[2, 3]
    if z < MIN_DEPTH_M:
        squared[n] = UNSEEN_SQUARED_ERROR
        return CAUCHY_SCALE_SQUARED * math.log(1.0 + UNSEEN_SQUARED_ERROR / CAUCHY_SCALE_SQUARED)
    J, A = np.empty((2, 6)), np.empty((2, 3))
    u, v = x / z, y / z
    du, dv = ray[0] - u, ray[1] - v
    squared[n] = (du * du + dv * dv) / (sigma * sigma)
    weight = 1.0 / (sigma * sigma * (1.0 + squared[n] / CAUCHY_SCALE_SQUARED))
    J[0, 0], J[0, 1], J[0, 2] = 1.0 / z, 0.0, -u / z
    J[1, 0], J[1, 1], J[1, 2] = 0.0, 1.0 / z, -v / z
    J[0, 3], J[0, 4], J[0, 5] = -u * v, 1.0 + u * u, -v
    J[1, 3], J[1, 4], J[1, 5] = -1.0 - v * v, u * v, u
    for a in range(2):
        for c in range(3):
            A[a, c] = J[a, 0] * T[0, c] + J[a, 1] * T[1, c] + J[a, 2] * T[2, c]
    for a in range(3):
        b[a] += weight * (A[0, a] * du + A[1, a] * dv)
        for c in range(3):
            V[a, c] += weight * (A[0, a] * A[0, c] + A[1, a] * A[1, c])
    for a in range(6):
        gradient[row + a] += weight * (J[0, a] * du + J[1, a] * dv)
        for c in range(6):
            H[row + a, row + c] += weight * (J[0, a] * J[0, c] + J[1, a] * J[1, c])
        for c in range(3):
            mixed[a, c] = weight * (J[0, a] * A[0, c] + J[1, a] * A[1, c])
    return CAUCHY_SCALE_SQUARED * math.log(1.0 + squared[n] / CAUCHY_SCALE_SQUARED)


@inline_kernel
def _invert_symmetric_3x3(V: Array, inverse: Array) -> None:
    """Inverse of a symmetric 3x3 matrix, by its cofactors."""
    c0 = V[1, 1] * V[2, 2] - V[1, 2] * V[1, 2]
    c1 = V[0, 2] * V[1, 2] - V[0, 1] * V[2, 2]
    c2 = V[0, 1] * V[1, 2] - V[0, 2] * V[1, 1]
    det = V[0, 0] * c0 + V[0, 1] * c1 + V[0, 2] * c2
    inverse[0, 0] = c0 / det
    inverse[0, 1] = inverse[1, 0] = c1 / det
    inverse[0, 2] = inverse[2, 0] = c2 / det
    inverse[1, 1] = (V[0, 0] * V[2, 2] - V[0, 2] * V[0, 2]) / det
    inverse[1, 2] = inverse[2, 1] = (V[0, 1] * V[0, 2] - V[0, 0] * V[1, 2]) / det
    inverse[2, 2] = (V[0, 0] * V[1, 1] - V[0, 1] * V[0, 1]) / det


@inline_kernel
def _eliminate_point(
    equations: BundleEquations, view: Indices, point: Indices, begin: int, end: int
) -> None:
    """Eliminate a point, with observations from `begin` to `end`, from the views' equations."""
    H, gradient, mixed = equations.H, equations.gradient, equations.mixed
    point_inverse = equations.point_inverse[point[begin]]
    point_gradient = equations.point_gradient
    gain = np.empty((6, 3))
    b = point_gradient[point[begin]]
    for i in range(begin, end):
        for a in range(6):
            for c in range(3):
                gain[a, c] = 0.0
                for k in range(3):
                    gain[a, c] += mixed[i, a, k] * point_inverse[k, c]
                gradient[6 * view[i] + a] -= gain[a, c] * b[c]
        for j in range(begin, end):
            for a in range(6):
                for c in range(6):
                    for k in range(3):
                        H[6 * view[i] + a, 6 * view[j] + c] -= gain[a, k] * mixed[j, c, k]


@kernel
def update_points(
    position_m: Array, observations: BundleObservations, equations: BundleEquations, step: Array
) -> None:
    """Move every point (L, 3), in place, to its optimum after the step (6 K,) of the views.

    Args:
        position_m: (L, 3), in and out.
        observations: Of the points in the views.
        equations: Normal equations at the old positions.
        step: (6 K,) of the views.
    """
    view, point = observations.view_index, observations.point_index
    point_inverse, point_gradient = equations.point_inverse, equations.point_gradient
    mixed = equations.mixed
    begin = 0
    while begin < len(point):
        end = begin
        gradient = point_gradient[point[begin]].copy()
        while end < len(point) and point[end] == point[begin]:
            for c in range(3):
                for a in range(6):
                    gradient[c] -= mixed[end, a, c] * step[6 * view[end] + a]
            end += 1
        for a in range(3):
            for c in range(3):
                position_m[point[begin], a] += point_inverse[point[begin], a, c] * gradient[c]
        begin = end


MAX_ITERATIONS = 6
INITIAL_DAMPING, MAX_DAMPING, MIN_DAMPING = 1e-4, 1e2, 1e-9
# The adjustment ends when a step reduces the cost by a smaller share.
MIN_RELATIVE_GAIN = 1e-4
# Keeps the system solvable for a view without observations.
INFORMATION_FLOOR = 1e-3


@dataclass(frozen=True)
class BundleResult:
    """Result of a bundle adjustment.

    Attributes:
        T_view_world: (K, 4, 4).
        position_m: (L, 3) in the world frame.
        covariance: (L, 3, 3) of the points, given the poses.
        squared_error: (O,) squared errors in standard deviations.
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
    equations: BundleEquations


def adjust_bundle(
    T_view_world: Array, position_m: Array, observations: BundleObservations
) -> BundleResult:
    """Adjust poses (K, 4, 4) and points (L, 3); the first pose is fixed.

    Args:
        T_view_world: (K, 4, 4) initial poses.
        position_m: (L, 3) initial points in the world frame.
        observations: Of the points in the views.
    """
    damping = INITIAL_DAMPING
    current = _linearize(T_view_world, position_m, observations, damping)
    for _ in range(MAX_ITERATIONS):
        stepped = _take_step(current, observations, damping)
        if stepped.cost < current.cost:
            has_converged = current.cost - stepped.cost < MIN_RELATIVE_GAIN * current.cost
            current, damping = stepped, max(0.1 * damping, MIN_DAMPING)
            if has_converged:
                break
        else:
            damping *= 10.0
            current = _linearize(current.T, current.position_m, observations, damping)
            if damping > MAX_DAMPING:
                break
    equations = current.equations
    return BundleResult(
        current.T, current.position_m, equations.point_inverse, equations.squared_error
    )


def _linearize(
    T: Array, position_m: Array, observations: BundleObservations, damping: float
) -> _BundleSystem:
    equations = BundleEquations.zeros(len(T), len(position_m), len(observations.view_index))
    cost = accumulate_bundle(T, position_m, observations, damping, equations)
    return _BundleSystem(T, position_m, cost, equations)


def _take_step(
    system: _BundleSystem, observations: BundleObservations, damping: float
) -> _BundleSystem:
    """Linearize after one damped step; the first view is fixed."""
    H, gradient = system.equations.H, system.equations.gradient
    free = H[6:, 6:].copy()
    free[np.diag_indices_from(free)] *= 1.0 + damping
    free[np.diag_indices_from(free)] += INFORMATION_FLOOR
    step = np.zeros(len(gradient))
    step[6:] = np.linalg.solve(free, gradient[6:])
    position_m = system.position_m.copy()
    update_points(position_m, observations, system.equations, step)
    motions = [rigid_transform(so3_exp(each[3:]), each[:3]) for each in step.reshape(-1, 6)]
    T = np.array(
        [orthonormalize(motion @ pose) for motion, pose in zip(motions, system.T, strict=True)]
    )
    return _linearize(T, position_m, observations, 0.1 * damping)
