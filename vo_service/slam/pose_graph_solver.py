"""Pose graph optimization: sparse least squares over rigid transforms.

Grisetti, Kuemmerle, Stachniss and Burgard, "A tutorial on graph-based SLAM" (2010); damped after
Levenberg and Marquardt. Loops have Cauchy's cost, so that wrong ones have little weight.

SciPy takes 20 MB, so it is imported with the first loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.slam.graph_edges import Edge

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def invert_poses(T: Array) -> Array:
    """Inverses of rigid transforms (..., 4, 4)."""
    transposed = np.swapaxes(T[..., :3, :3], -1, -2)
    result = np.zeros_like(T)
    result[..., :3, :3] = transposed
    result[..., :3, 3] = -(transposed @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def skew_matrices(v: Array) -> Array:
    """(..., 3, 3) matrices of the cross products with vectors (..., 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def so3_exp_batch(vectors_rad: Array) -> Array:
    """Rodrigues' formula: (..., 3, 3) rotations about vectors (..., 3) by their lengths."""
    turn = np.linalg.norm(vectors_rad, axis=-1)[..., None, None] / np.pi
    K = skew_matrices(vectors_rad)
    R: Array = np.eye(3) + np.sinc(turn) * K + 0.5 * np.sinc(0.5 * turn) ** 2 * (K @ K)
    return R


def so3_log_batch(R: Array) -> Array:
    """Axis times angle (..., 3), radians, of rotations (..., 3, 3) by less than pi."""
    twice = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    trace = np.trace(R, axis1=-2, axis2=-1)
    angle = np.arctan2(np.linalg.norm(twice, axis=-1), trace - 1.0)
    vectors_rad: Array = 0.5 * twice / np.sinc(angle / np.pi)[..., None]
    return vectors_rad


def retract_poses(T: Array, steps: Array) -> Array:
    """Apply steps (..., 6) to rigid transforms (..., 4, 4) in their own axes.

    A step is (translation m, rotation rad). One Newton iteration keeps the rotations orthonormal.
    """
    R = T[..., :3, :3]
    rotated = R @ so3_exp_batch(steps[..., 3:])
    result = T.copy()
    result[..., :3, :3] = 0.5 * rotated @ (3.0 * np.eye(3) - np.swapaxes(rotated, -1, -2) @ rotated)
    result[..., :3, 3] += (R @ steps[..., :3, None])[..., 0]
    return result


# Largest squared error, in standard deviations, of an inlier loop: 99.9 % of right ones (chi
# squared, six degrees of freedom). There the weight is half.
INLIER_CHI2 = 22.5
MAX_ITERATIONS = 30
INITIAL_DAMPING, MAX_DAMPING = 1e-6, 1e3
# The iteration ends when a step changes the cost by less than this share.
MIN_COST_DECREASE_RATIO = 1e-4
# Lower bound of an edge's sigma, in meters and radians.
MIN_SIGMA = 1e-5

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class EdgeMeasurements:
    """The edges as arrays.

    Attributes:
        a: (E,) row of the pose a.
        b: (E,) row of the pose b.
        T_b_a: (E, 4, 4) inverse of the measured T_a_b.
        whitening: (E, 6, 6) transforms an error to standard deviations.
        is_loop: (E,).
    """

    a: Indices
    b: Indices
    T_b_a: Array
    whitening: Array
    is_loop: NDArray[np.bool_]


@dataclass(frozen=True)
class _LinearizedGraph:
    """Poses (N, 4, 4), their cost, and the normal equations of the free poses."""

    T_map_keyframe: Array
    cost: float
    H: "csr_array"
    gradient: Array


def collect_measurements(edges: Sequence[Edge], rows: dict[int, int]) -> EdgeMeasurements:
    """Collect the measurements of edges; `rows` has the row of each node."""
    covariance = np.array([edge.covariance for edge in edges]) + MIN_SIGMA**2 * np.eye(6)
    return EdgeMeasurements(
        np.array([rows[edge.a] for edge in edges]),
        np.array([rows[edge.b] for edge in edges]),
        invert_poses(np.array([edge.T_a_b for edge in edges])),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        np.array([edge.is_loop for edge in edges]),
    )


def squared_errors(T_map_keyframe: Array, measured: EdgeMeasurements) -> Array:
    """(E,) squared errors of the edges in standard deviations, at poses (N, 4, 4)."""
    squared: Array = np.sum(_whitened_errors(T_map_keyframe, measured) ** 2, axis=1)
    return squared


def solve(T_map_keyframe: Array, measured: EdgeMeasurements, is_fixed: NDArray[np.bool_]) -> Array:
    """Optimize the poses (N, 4, 4).

    Args:
        T_map_keyframe: (N, 4, 4) initial poses.
        is_fixed: (N,), at least one pose of each component.
    """
    damping = INITIAL_DAMPING
    current = _linearize(T_map_keyframe, measured, is_fixed)
    for _ in range(MAX_ITERATIONS):
        stepped = _linearize(_take_step(current, is_fixed, damping), measured, is_fixed)
        gain = current.cost - stepped.cost
        has_converged = abs(gain) <= MIN_COST_DECREASE_RATIO * (1.0 + current.cost)
        if gain > 0.0:
            current, damping = stepped, 0.1 * damping
        else:
            damping *= 10.0
        if has_converged or damping > MAX_DAMPING:
            break
    return current.T_map_keyframe


def _take_step(current: _LinearizedGraph, is_fixed: NDArray[np.bool_], damping: float) -> Array:
    """Poses after one damped step."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    damped = current.H + diags_array(damping * current.H.diagonal())
    # Symmetric and positive definite: without pivoting the factor stays sparse.
    factor = splu(
        damped.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    T_map = current.T_map_keyframe.copy()
    T_map[~is_fixed] = retract_poses(
        T_map[~is_fixed], -factor.solve(current.gradient).reshape(-1, 6)
    )
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
    """(E, 6) error of each b against its measurement, in standard deviations."""
    T = measured.T_b_a @ invert_poses(T_map_keyframe[measured.a]) @ T_map_keyframe[measured.b]
    errors = np.concatenate([T[:, :3, 3], so3_log_batch(T[:, :3, :3])], axis=1)
    whitened: Array = (measured.whitening @ errors[..., None])[..., 0]
    return whitened


def _jacobian_blocks(T_map_keyframe: Array, measured: EdgeMeasurements) -> Array:
    """(E, 6, 12) Jacobians of the errors in m and rad by steps of a and b, see `retract_poses`."""
    T_a_b = invert_poses(T_map_keyframe[measured.a]) @ T_map_keyframe[measured.b]
    R_b_a = measured.T_b_a[:, :3, :3]
    R_error = R_b_a @ T_a_b[:, :3, :3]
    # Inverse of the right Jacobian of SO(3), up to the third power.
    K = skew_matrices(so3_log_batch(R_error))
    right_jacobian_inverse = np.eye(3) + K / 2.0 + K @ K / 12.0
    J = np.zeros((len(T_a_b), 6, 12))
    J[:, :3, :3] = -R_b_a
    J[:, :3, 3:6] = R_b_a @ skew_matrices(T_a_b[:, :3, 3])
    J[:, 3:, 3:6] = -right_jacobian_inverse @ np.swapaxes(T_a_b[:, :3, :3], 1, 2)
    J[:, :3, 6:9] = R_error
    J[:, 3:, 9:] = right_jacobian_inverse
    return J


def _sparse_jacobian(
    blocks: Array, measured: EdgeMeasurements, is_fixed: NDArray[np.bool_]
) -> "csr_array":
    """(6 E, 6 free) matrix of blocks (E, 6, 12), without the columns of fixed poses."""
    from scipy.sparse import csr_array

    rank = np.empty(len(is_fixed), np.int32)
    rank[np.argsort(is_fixed, kind="stable")] = np.arange(len(is_fixed), dtype=np.int32)
    first = 6 * rank[np.stack([measured.a, measured.b], axis=1)]
    columns = (first[..., None] + np.arange(6, dtype=np.int32)).reshape(-1, 1, 12)
    indices = np.broadcast_to(columns, blocks.shape).ravel()
    starts = np.arange(0, blocks.size + 1, 12)
    J = csr_array((blocks.ravel(), indices, starts), shape=(len(starts) - 1, 6 * len(is_fixed)))
    return J[:, : 6 * np.count_nonzero(~is_fixed)]
