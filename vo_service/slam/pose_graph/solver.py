"""The poses that agree best with all edges of a graph: sparse least squares over rigid motions.

Grisetti, Kuemmerle, Stachniss and Burgard, "A tutorial on graph-based SLAM" (2010); damped after
Levenberg and Marquardt. Loops count by Cauchy's function: one that contradicts all others pulls the
less, the more it does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from drivers.core.geometry import Array
from vo_service.slam.pose_graph.batched_se3 import (
    invert_poses,
    retract_poses,
    skew_matrices,
    so3_log_batch,
)
from vo_service.slam.pose_graph.edges import Edge

# A loop is believed whose squared error, in standard deviations, is at most this: so are 99.9 % of
# right ones (chi squared, six degrees of freedom). There it weighs half.
INLIER_CHI2 = 22.5
MAX_ITERATIONS = 30
INITIAL_DAMPING, MAX_DAMPING = 1e-6, 1e3
# Enough when a step changes the cost by less than this share.
MIN_COST_DECREASE_RATIO = 1e-4
# Nothing is surer than this, in metres and radians.
MIN_SIGMA = 1e-5

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class EdgeMeasurements:
    """The edges as arrays.

    a, b       (E,) rows of the poses that they join
    T_b_a      (E, 4, 4) inverse of what was measured
    whitening  (E, 6, 6) turns an error into one of standard deviations
    is_loop    (E,)
    """

    a: Indices
    b: Indices
    T_b_a: Array
    whitening: Array
    is_loop: NDArray[np.bool_]


@dataclass(frozen=True)
class _LinearizedGraph:
    """Poses (N, 4, 4), their cost, and the normal equations there of the poses that are free."""

    T_map_keyframe: Array
    cost: float
    H: csr_array
    gradient: Array


def collect_measurements(edges: Sequence[Edge], rows: dict[int, int]) -> EdgeMeasurements:
    """What the edges say; `rows` tells the row of each place."""
    covariance = np.array([edge.covariance for edge in edges]) + MIN_SIGMA**2 * np.eye(6)
    return EdgeMeasurements(
        np.array([rows[edge.a] for edge in edges]),
        np.array([rows[edge.b] for edge in edges]),
        invert_poses(np.array([edge.T_a_b for edge in edges])),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        np.array([edge.is_loop for edge in edges]),
    )


def squared_errors(T_map_keyframe: Array, measured: EdgeMeasurements) -> Array:
    """(E,) squared errors of the edges in standard deviations, the places being at T_map."""
    squared: Array = np.sum(_whitened_errors(T_map_keyframe, measured) ** 2, axis=1)
    return squared


def solve(T_map_keyframe: Array, measured: EdgeMeasurements, is_fixed: NDArray[np.bool_]) -> Array:
    """The poses (N, 4, 4) that agree best, near those given; those that are held stay.

    is_held  (N,), at least one pose of all that are connected
    """
    damping = INITIAL_DAMPING
    now = _linearize(T_map_keyframe, measured, is_fixed)
    for _ in range(MAX_ITERATIONS):
        then = _linearize(_take_step(now, is_fixed, damping), measured, is_fixed)
        gain = now.cost - then.cost
        is_enough = abs(gain) <= MIN_COST_DECREASE_RATIO * (1.0 + now.cost)
        if gain > 0.0:
            now, damping = then, 0.1 * damping
        else:
            damping *= 10.0
        if is_enough or damping > MAX_DAMPING:
            break
    return now.T_map_keyframe


def _take_step(now: _LinearizedGraph, is_fixed: NDArray[np.bool_], damping: float) -> Array:
    """The poses after one damped step."""
    damped = now.H + diags_array(damping * now.H.diagonal())
    # Symmetric and positive: no pivot need be looked for, which keeps the factor sparse.
    factor = splu(
        damped.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    T_map = now.T_map_keyframe.copy()
    T_map[~is_fixed] = retract_poses(T_map[~is_fixed], -factor.solve(now.gradient).reshape(-1, 6))
    return T_map


def _linearize(
    T_map_keyframe: Array, measured: EdgeMeasurements, is_fixed: NDArray[np.bool_]
) -> _LinearizedGraph:
    errors = _whitened_errors(T_map_keyframe, measured)
    squared = np.sum(errors**2, axis=1)
    costs = np.where(measured.is_loop, INLIER_CHI2 * np.log1p(squared / INLIER_CHI2), squared)
    weights = np.where(measured.is_loop, 1.0 / (1.0 + squared / INLIER_CHI2), 1.0)
    roots = np.sqrt(weights)[:, None]
    J = _sparse_jacobian(
        roots[..., None] * measured.whitening @ _jacobian_blocks(T_map_keyframe, measured),
        measured,
        is_fixed,
    )
    return _LinearizedGraph(
        T_map_keyframe, float(np.sum(costs)), J.T @ J, J.T @ (roots * errors).ravel()
    )


def _whitened_errors(T_map_keyframe: Array, measured: EdgeMeasurements) -> Array:
    """(E, 6) how far each b is from where it was measured, in standard deviations."""
    T = measured.T_b_a @ invert_poses(T_map_keyframe[measured.a]) @ T_map_keyframe[measured.b]
    errors = np.concatenate([T[:, :3, 3], so3_log_batch(T[:, :3, :3])], axis=1)
    whitened: Array = (measured.whitening @ errors[..., None])[..., 0]
    return whitened


def _jacobian_blocks(T_map_keyframe: Array, measured: EdgeMeasurements) -> Array:
    """(E, 6, 12) of the errors in metres and radians by small steps of a and of b (see `moved`)."""
    T_a_b = invert_poses(T_map_keyframe[measured.a]) @ T_map_keyframe[measured.b]
    R_b_a = measured.T_b_a[:, :3, :3]
    R_error = R_b_a @ T_a_b[:, :3, :3]
    # Of the rotation vector by a small turn afterwards: the inverse of the right Jacobian of SO(3),
    # up to the third power.
    K = skew_matrices(so3_log_batch(R_error))
    by_turn = np.eye(3) + K / 2.0 + K @ K / 12.0
    J = np.zeros((len(T_a_b), 6, 12))
    J[:, :3, :3] = -R_b_a
    J[:, :3, 3:6] = R_b_a @ skew_matrices(T_a_b[:, :3, 3])
    J[:, 3:, 3:6] = -by_turn @ np.swapaxes(T_a_b[:, :3, :3], 1, 2)
    J[:, :3, 6:9] = R_error
    J[:, 3:, 9:] = by_turn
    return J


def _sparse_jacobian(
    blocks: Array, measured: EdgeMeasurements, is_fixed: NDArray[np.bool_]
) -> csr_array:
    """(6 E, 6 free) matrix of blocks (E, 6, 12), without the columns of what is held."""
    place = np.empty(len(is_fixed), np.int32)
    place[np.argsort(is_fixed, kind="stable")] = np.arange(len(is_fixed), dtype=np.int32)
    first = 6 * place[np.stack([measured.a, measured.b], axis=1)]
    columns = (first[..., None] + np.arange(6, dtype=np.int32)).reshape(-1, 1, 12)
    indices = np.broadcast_to(columns, blocks.shape).ravel()
    starts = np.arange(0, blocks.size + 1, 12)
    J = csr_array((blocks.ravel(), indices, starts), shape=(len(starts) - 1, 6 * len(is_fixed)))
    return J[:, : 6 * np.count_nonzero(~is_fixed)]
