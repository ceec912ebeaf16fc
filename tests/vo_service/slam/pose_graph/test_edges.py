"""Orientation and composition of edges."""

import numpy as np

from drivers.core.geometry import Array, inverse
from tests.vo_service.slam.pose_graph.ring_graphs import loop_edge, odometry_edge, ring_pose
from vo_service.slam.pose_graph.batched_se3 import invert_poses, retract_poses, so3_log_batch
from vo_service.slam.pose_graph.edges import Edge

T_AB, T_BC = ring_pose(7, 1), ring_pose(5, 2)
# Different in every direction, so that swapped axes are detected.
SIGMA = np.array([1.0, 2.0, 3.0, 0.5, 1.0, 1.5]) * 1e-3
SAMPLES = 4000


def edge(a: int, b: int, T_a_b: Array) -> Edge:
    return Edge(a, b, T_a_b, np.diag(SIGMA**2), is_loop=False, length_m=2.0)


def sample_edges(T: Array, seed: int) -> Array:
    """(SAMPLES, 4, 4) samples of T with the covariance."""
    steps = np.random.default_rng(seed).normal(0.0, SIGMA, (SAMPLES, 6))
    return retract_poses(np.tile(T, (SAMPLES, 1, 1)), steps)


def assert_spread(samples: Array, truth: Array, covariance: Array) -> None:
    """Check that the samples have the covariance, as small motions in the axes of b."""
    T = inverse(truth) @ samples
    found = np.cov(np.hstack([T[:, :3, 3], so3_log_batch(T[:, :3, :3])]).T)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    np.testing.assert_allclose(whitening @ found @ whitening.T, np.eye(6), atol=0.1)


def test_a_reversed_edge_is_the_inverse_with_its_covariance() -> None:
    back = edge(1, 2, T_AB).oriented_from(2)
    assert (back.a, back.b, back.length_m) == (2, 1, 2.0)
    np.testing.assert_allclose(back.T_a_b, inverse(T_AB))
    assert_spread(invert_poses(sample_edges(T_AB, 1)), inverse(T_AB), back.covariance)


def test_an_edge_reversed_twice_is_the_same() -> None:
    one = edge(1, 2, T_AB)
    assert one.oriented_from(1) is one
    again = one.oriented_from(2).oriented_from(1)
    np.testing.assert_allclose(again.T_a_b, T_AB, atol=1e-15)
    np.testing.assert_allclose(again.covariance, one.covariance, atol=1e-18)


def test_two_composed_edges_have_both_covariances() -> None:
    both = edge(1, 2, T_AB).compose(edge(2, 3, T_BC))
    assert (both.a, both.b, both.length_m) == (1, 3, 4.0)
    np.testing.assert_allclose(both.T_a_b, T_AB @ T_BC, atol=1e-15)
    assert_spread(sample_edges(T_AB, 1) @ sample_edges(T_BC, 2), T_AB @ T_BC, both.covariance)


def test_a_composition_with_a_loop_is_no_odometry_edge() -> None:
    saved_wall, revisited = odometry_edge(1, 2, T_AB), loop_edge(2, 3, T_BC)
    assert saved_wall.compose(revisited).is_loop
    assert revisited.oriented_from(3).compose(saved_wall.oriented_from(2)).is_loop
    assert not saved_wall.compose(odometry_edge(2, 3, T_BC)).is_loop


def test_an_edge_connects_two_ends() -> None:
    one = edge(4, 9, T_AB)
    assert (one.other_end(4), one.other_end(9)) == (9, 4)
