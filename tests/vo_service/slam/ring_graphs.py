"""Pose graphs of rings, with noise by the edges' covariance."""

import numpy as np

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from vo_service.slam.graph_edges import Edge
from vo_service.slam.pose_graph import PoseGraph

# Sigmas (m, rad) of an odometry edge and of a loop closure.
STEP_SIGMA, LOOP_SIGMA = (4e-3, 1e-3), (2e-3, 5e-4)
NO_SIGMA = (0.0, 0.0)

Sigma = tuple[float, float]


def ring_pose(ring: int, k: int) -> Array:
    """T_world_keyframe of the k-th keyframe of a ring of 12 m; the first one is the world frame."""

    def at(angle_rad: float) -> Array:
        turn = so3_exp([0.1 * np.sin(2 * angle_rad), 0.0, angle_rad])
        x, y, z = np.cos(angle_rad), np.sin(angle_rad), 0.1 * np.sin(2 * angle_rad)
        return rigid_transform(turn, [2.0 * x, 2.0 * y, z])

    return inverse(at(0.0)) @ at(2.0 * np.pi * k / ring)


def sample_noise(rng: np.random.Generator, sigma: Sigma) -> Array:
    turn = so3_exp(rng.normal(0.0, sigma[1], 3))
    return rigid_transform(turn, rng.normal(0.0, sigma[0], 3))


def make_covariance(sigma: Sigma) -> Array:
    return np.diag([sigma[0] ** 2] * 3 + [sigma[1] ** 2] * 3)


def odometry_edge(a: int, b: int, T_a_b: Array, sigma: Sigma = STEP_SIGMA) -> Edge:
    length_m = float(np.linalg.norm(T_a_b[:3, 3]))
    return Edge(a, b, T_a_b, make_covariance(sigma), is_loop=False, length_m=length_m)


def loop_edge(a: int, b: int, T_a_b: Array, sigma: Sigma = LOOP_SIGMA) -> Edge:
    return Edge(a, b, T_a_b, make_covariance(sigma), is_loop=True, length_m=0.0)


def make_graph(
    truth: list[Array],
    rng: np.random.Generator,
    sigma: Sigma = STEP_SIGMA,
    graph: PoseGraph | None = None,
    first: int = 0,
    world: int = 0,
) -> PoseGraph:
    """A graph of keyframes numbered from `first` on, with this noise of the odometry."""
    graph = graph or PoseGraph()
    graph.add_node(first, world, np.eye(4))
    for k in range(1, len(truth)):
        T = inverse(truth[k - 1]) @ truth[k] @ sample_noise(rng, sigma)
        graph.add_odometry_edge(odometry_edge(first + k - 1, first + k, T))
    return graph


def graph_poses(graph: PoseGraph) -> Array:
    return np.array([graph.T_map_keyframe(number) for number in graph.nodes])


def rms_error_m(graph: PoseGraph, truth: list[Array]) -> float:
    """Root mean square error of the keyframes' positions, m."""
    errors = [graph.T_map_keyframe(number)[:3, 3] - truth[number][:3, 3] for number in graph.nodes]
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
