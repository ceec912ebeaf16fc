"""The solver of the pose graph, and its SE(3) functions for many poses."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.geometry import (
    Array,
    inverse,
    is_rigid,
    rigid_transform,
    skew_matrix,
    so3_exp,
    so3_log,
)
from tests.vo_service.slam.ring_graphs import loop_edge, odometry_edge, ring_pose
from vo_service.slam.graph_edges import Edge
from vo_service.slam.pose_graph_solver import (
    INLIER_CHI2,
    collect_measurements,
    invert_poses,
    retract_poses,
    skew_matrices,
    so3_exp_batch,
    so3_log_batch,
    solve,
    squared_errors,
)

FEW = settings(max_examples=30)
# Each shorter than half a turn.
VECTORS = arrays(np.float64, (3, 3), elements=st.floats(-1.8, 1.8, allow_subnormal=False))
STEPS = arrays(np.float64, (3, 6), elements=st.floats(-3.0, 3.0, allow_subnormal=False))


def stack(steps: Array) -> Array:
    return np.array([rigid_transform(so3_exp(step[3:]), step[:3]) for step in steps])


@FEW
@given(VECTORS)
def test_batched_rotations_equal_single_ones(vectors_rad: Array) -> None:
    each = [so3_exp(vector) for vector in vectors_rad]
    np.testing.assert_allclose(so3_exp_batch(vectors_rad), each, atol=1e-14)
    cross = [skew_matrix(vector) for vector in vectors_rad]
    np.testing.assert_array_equal(skew_matrices(vectors_rad), cross)


@FEW
@given(VECTORS)
def test_batched_rotation_vectors_equal_single_ones(vectors_rad: Array) -> None:
    R = so3_exp_batch(vectors_rad)
    np.testing.assert_allclose(so3_log_batch(R), [so3_log(r) for r in R], atol=1e-9)


@FEW
@given(STEPS)
def test_an_inverse_cancels_its_transform(steps: Array) -> None:
    T = stack(steps)
    np.testing.assert_array_equal(invert_poses(T), [inverse(each) for each in T])
    np.testing.assert_allclose(invert_poses(T) @ T, np.tile(np.eye(4), (3, 1, 1)), atol=1e-13)


@FEW
@given(STEPS)
def test_a_step_is_in_the_axes_of_the_moving_frame(steps: Array) -> None:
    T = stack(steps[::-1])
    np.testing.assert_allclose(retract_poses(T, steps), T @ stack(steps), atol=1e-12)


def test_a_transform_stays_rigid_after_many_steps() -> None:
    T, step = stack(np.full((1, 6), 0.5)), np.full((1, 6), 0.3)
    for _ in range(1000):
        T = retract_poses(T, step)
    assert is_rigid(T[0], tolerance=1e-14)


TRUTH = np.array([ring_pose(6, k) for k in range(6)])
ROWS = {k: k for k in range(6)}
FIRST = np.arange(6) == 0
GRAPH_STEPS = arrays(np.float64, (6, 6), elements=st.floats(-0.3, 0.3, allow_subnormal=False))


def ring(T: Array) -> list[Edge]:
    """Motions from place to place, and a loop between the last and the first."""
    motions = [odometry_edge(k, k + 1, inverse(T[k]) @ T[k + 1]) for k in range(5)]
    return [*motions, loop_edge(5, 0, inverse(T[5]) @ T[0])]


def cost(T: Array, edges: list[Edge]) -> float:
    return float(np.sum(squared_errors(T, collect_measurements(edges, ROWS))))


@FEW
@given(GRAPH_STEPS)
def test_moved_keyframes_converge_to_the_edges(steps: Array) -> None:
    steps[0] = 0.0
    found = solve(retract_poses(TRUTH, steps), collect_measurements(ring(TRUTH)[:-1], ROWS), FIRST)
    np.testing.assert_allclose(found, TRUTH, atol=1e-6)


@FEW
@given(GRAPH_STEPS)
def test_consistent_edges_change_nothing(steps: Array) -> None:
    T = retract_poses(TRUTH, steps)
    found = solve(T, collect_measurements(ring(T), ROWS), FIRST)
    np.testing.assert_allclose(found, T, atol=1e-12)


def test_fixed_nodes_stay_bit_for_bit_and_the_others_stay_rigid() -> None:
    rng = np.random.default_rng(1)
    edges = ring(retract_poses(TRUTH, rng.normal(0.0, 0.01, (6, 6))))
    is_fixed = np.isin(np.arange(6), [0, 3])
    found = solve(TRUTH, collect_measurements(edges, ROWS), is_fixed)
    np.testing.assert_array_equal(found[is_fixed], TRUTH[is_fixed])
    assert np.all(np.any(found != TRUTH, axis=(1, 2)) == ~is_fixed)
    assert all(is_rigid(T, tolerance=1e-12) for T in found)


def test_the_solution_is_a_local_minimum() -> None:
    rng = np.random.default_rng(2)
    motions = [edge for edge in ring(TRUTH) if not edge.is_loop]
    bent = retract_poses(TRUTH, rng.normal(0.0, 0.05, (6, 6)))
    # Two tellings of the same motions: the best is somewhere between.
    edges = [*motions, *(edge for edge in ring(bent) if not edge.is_loop)]
    found = solve(TRUTH, collect_measurements(edges, ROWS), FIRST)
    least = cost(found, edges)
    for axis in range(6):
        for size in (-1e-3, 1e-3):
            step = np.zeros((6, 6))
            step[3, axis] = size
            assert cost(retract_poses(found, step), edges) > least


@pytest.mark.parametrize("error_m", [0.01, 0.03, 0.3])
def test_a_loop_has_cauchys_loss(error_m: float) -> None:
    *motions, right = ring(TRUTH)
    wrong = replace(
        right, T_a_b=retract_poses(right.T_a_b, np.array([error_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    )
    measured = collect_measurements([*motions, wrong], ROWS)

    def cauchy_cost(T: Array) -> float:
        squared = squared_errors(T, measured)
        return float(squared[:-1].sum() + INLIER_CHI2 * np.log1p(squared[-1] / INLIER_CHI2))

    found = solve(TRUTH, measured, FIRST)
    least = cauchy_cost(found)
    for row, axis, size in product(range(1, 6), range(6), (-3e-4, 3e-4)):
        step = np.zeros((6, 6))
        step[row, axis] = size
        assert cauchy_cost(retract_poses(found, step)) > least


def test_an_error_is_reported_in_standard_deviations() -> None:
    (only,) = ring(TRUTH)[:1]
    step = np.zeros((6, 6))
    step[1] = 3.0 * np.sqrt(np.diag(only.covariance)) * np.eye(6)[2]
    (squared,) = squared_errors(retract_poses(TRUTH, step), collect_measurements([only], ROWS))
    np.testing.assert_allclose(squared, 9.0, rtol=1e-4)


def test_an_edge_with_zero_covariance_is_no_error() -> None:
    sure = odometry_edge(0, 1, TRUTH[1], sigma=(0.0, 0.0))
    found = solve(TRUTH, collect_measurements([sure, *ring(TRUTH)[1:]], ROWS), FIRST)
    np.testing.assert_allclose(found, TRUTH, atol=1e-12)
