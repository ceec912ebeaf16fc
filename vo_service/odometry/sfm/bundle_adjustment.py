"""Bundle adjustment of a few views: the poses and points with the least reprojection error.

Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment, a modern synthesis" (2000): the
points are eliminated (Schur complement), steps are damped (Levenberg and Marquardt), and the
cost is Cauchy's function.
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, orthonormalize, rigid_transform, so3_exp
from vo_service.odometry.sfm.bundle_kernels import (
    BundleEquations,
    BundleObservations,
    accumulate_bundle,
    update_points,
)

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
