"""Pose graph optimization."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.geometry import Array, inverse, is_rigid
from tests.vo_service.slam.pose_graph.ring_graphs import loop_edge, odometry_edge, ring_pose
from vo_service.slam.pose_graph.batched_se3 import retract_poses
from vo_service.slam.pose_graph.edges import Edge
from vo_service.slam.pose_graph.solver import (
    INLIER_CHI2,
    collect_measurements,
    solve,
    squared_errors,
)

FEW = settings(max_examples=30)
TRUTH = np.array([ring_pose(6, k) for k in range(6)])
ROWS = {k: k for k in range(6)}
FIRST = np.arange(6) == 0
STEPS = arrays(np.float64, (6, 6), elements=st.floats(-0.3, 0.3, allow_subnormal=False))


def ring(T: Array) -> list[Edge]:
    """Motions from place to place, and a loop between the last and the first."""
    motions = [odometry_edge(k, k + 1, inverse(T[k]) @ T[k + 1]) for k in range(5)]
    return [*motions, loop_edge(5, 0, inverse(T[5]) @ T[0])]


def cost(T: Array, edges: list[Edge]) -> float:
    return float(np.sum(squared_errors(T, collect_measurements(edges, ROWS))))


@FEW
@given(STEPS)
def test_moved_keyframes_converge_to_the_edges(steps: Array) -> None:
    steps[0] = 0.0
    found = solve(retract_poses(TRUTH, steps), collect_measurements(ring(TRUTH)[:-1], ROWS), FIRST)
    np.testing.assert_allclose(found, TRUTH, atol=1e-6)


@FEW
@given(STEPS)
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
