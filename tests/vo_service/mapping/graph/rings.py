"""Places on rings that a camera walks, with noise as the edges tell of it."""

import numpy as np

from drivers.geometry import Array, inverse, rigid_transform, rotation_from_vector
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import PoseGraph

# (m, rad) of a step of the odometry, and of a place known again.
STEP, LOOP = (4e-3, 1e-3), (2e-3, 5e-4)
NONE = (0.0, 0.0)

Sigma = tuple[float, float]


def place_on(ring: int, k: int) -> Array:
    """T_world_place of the k-th place, where a lap of some 12 m has so many; world is the first."""

    def at(angle_rad: float) -> Array:
        turn = rotation_from_vector([0.1 * np.sin(2 * angle_rad), 0.0, angle_rad])
        x, y, z = np.cos(angle_rad), np.sin(angle_rad), 0.1 * np.sin(2 * angle_rad)
        return rigid_transform(turn, [2.0 * x, 2.0 * y, z])

    return inverse(at(0.0)) @ at(2.0 * np.pi * k / ring)


def noise(rng: np.random.Generator, sigma: Sigma) -> Array:
    turn = rotation_from_vector(rng.normal(0.0, sigma[1], 3))
    return rigid_transform(turn, rng.normal(0.0, sigma[0], 3))


def covariance(sigma: Sigma) -> Array:
    return np.diag([sigma[0] ** 2] * 3 + [sigma[1] ** 2] * 3)


def motion(a: int, b: int, T_a_b: Array, sigma: Sigma = STEP) -> Edge:
    length_m = float(np.linalg.norm(T_a_b[:3, 3]))
    return Edge(a, b, T_a_b, covariance(sigma), is_loop=False, length_m=length_m)


def loop(a: int, b: int, T_a_b: Array, sigma: Sigma = LOOP) -> Edge:
    return Edge(a, b, T_a_b, covariance(sigma), is_loop=True, length_m=0.0)


def walk(
    truth: list[Array],
    rng: np.random.Generator,
    sigma: Sigma = STEP,
    graph: PoseGraph | None = None,
    first: int = 0,
    world: int = 0,
) -> PoseGraph:
    """A graph of places numbered from `first` on, as an odometry with this noise tells of them."""
    graph = graph or PoseGraph()
    graph.add(first, world, np.eye(4))
    for k in range(1, len(truth)):
        T = inverse(truth[k - 1]) @ truth[k] @ noise(rng, sigma)
        graph.extend(motion(first + k - 1, first + k, T))
    return graph


def poses(graph: PoseGraph) -> Array:
    return np.array([graph.T_map(number) for number in graph.nodes])


def rms_m(graph: PoseGraph, truth: list[Array]) -> float:
    """Root mean square of how far the places are from the truth, the first being where it is."""
    errors = [graph.T_map(number)[:3, 3] - truth[number][:3, 3] for number in graph.nodes]
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
