"""Pose graph: keyframes, odometry edges and loop closures, and the optimized trajectory.

A loop closure is checked by `is_plausible` and added by `add_loop_closure`, then `optimize` is
called.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.geometry import Array, Trajectory, inverse, orthonormalize, pose_distance
from vo_service.slam.graph_edges import (
    Edge,
    add_to_adjacency,
    build_adjacency,
    connected_components,
    edge_to_neighbor,
    is_informative,
    marginalize_edges,
    shortest_path_length,
)
from vo_service.slam.pose_graph_solver import (
    INLIER_CHI2,
    EdgeMeasurements,
    collect_measurements,
    solve,
    squared_errors,
)

# Largest drift of the odometry: a constant, and per meter of the path.
MAX_DRIFT_M, MAX_DRIFT_M_PER_M = 0.05, 0.02
MAX_DRIFT_RAD, MAX_DRIFT_RAD_PER_M = np.deg2rad(2.0), np.deg2rad(0.5)


@dataclass(frozen=True, eq=False)
class Node:
    """A keyframe in the graph.

    Attributes:
        number: Ascending from keyframe to keyframe.
        world_id: World frame of the odometry.
        T_world_keyframe: 4x4 pose by the odometry.
        T_map_keyframe: 4x4 optimized pose.
    """

    number: int
    world_id: int
    T_world_keyframe: Array
    T_map_keyframe: Array


@dataclass(frozen=True, eq=False)
class NodeRemoval:
    """A removed node, and a neighbor that poses relative to it can be transformed to.

    Attributes:
        number: Of the removed node.
        neighbor: Number of the neighbor; None if it had none: then the pose is that in the map.
        T_neighbor_removed: 4x4.
    """

    number: int
    neighbor: int | None
    T_neighbor_removed: Array


class PoseGraph:
    """Keyframes and their edges.

    A connected component has one map frame, in which its oldest keyframe is fixed. Components are
    separate until a loop closure connects them.

    Args:
        nodes: Of a saved map.
        edges: Of a saved map.
    """

    def __init__(self, nodes: Iterable[Node] = (), edges: Iterable[Edge] = ()) -> None:
        self._nodes = {node.number: node for node in nodes}
        self._edges = list(edges)

    @property
    def nodes(self) -> Mapping[int, Node]:
        """The nodes by number."""
        return self._nodes

    @property
    def edges(self) -> Sequence[Edge]:
        """Odometry edges and loops, in chronological order."""
        return self._edges

    def add_node(self, number: int, world_id: int, T_world_keyframe: Array) -> None:
        """Add an unconnected node: the first one of a world frame.

        Args:
            world_id: Number of its world frame.
            T_world_keyframe: 4x4 pose of the keyframe in that frame, m.
        """
        self._nodes[number] = Node(number, world_id, T_world_keyframe, T_world_keyframe)

    def add_odometry_edge(self, edge: Edge) -> None:
        """Add the next node, `edge.b`, by the odometry from `edge.a`."""
        last = self._nodes[edge.a]
        self._nodes[edge.b] = Node(
            edge.b,
            last.world_id,
            orthonormalize(last.T_world_keyframe @ edge.T_a_b),
            orthonormalize(last.T_map_keyframe @ edge.T_a_b),
        )
        self._edges.append(edge)

    def T_map_keyframe(self, number: int) -> Array:
        """4x4 pose of a node in the map."""
        return self._nodes[number].T_map_keyframe

    def connected_components(self) -> list[set[int]]:
        """The connected components; the one with the oldest node is first."""
        return connected_components(self._nodes, self._edges)

    def are_connected(self, world_a: int, world_b: int) -> bool:
        """Whether nodes of these two world frames are connected."""
        world_ids = [
            {self._nodes[number].world_id for number in component}
            for component in self.connected_components()
        ]
        return any({world_a, world_b} <= ids for ids in world_ids)

    def is_plausible(self, loop: Edge) -> bool:
        """Whether the odometry can have drifted as much as this loop says.

        The largest drift is that of the shortest path over inlier edges. Any loop between
        unconnected nodes is plausible.
        """
        T_expected = inverse(self.T_map_keyframe(loop.a)) @ self.T_map_keyframe(loop.b)
        error_m, error_rad = pose_distance(T_expected, loop.T_a_b)
        needed_m = max(
            (error_m - MAX_DRIFT_M) / MAX_DRIFT_M_PER_M,
            (error_rad - MAX_DRIFT_RAD) / MAX_DRIFT_RAD_PER_M,
        )
        if needed_m <= 0.0:
            return True
        adjacency = build_adjacency(self.inlier_edges())
        path_m = shortest_path_length(
            loop.a, loop.b, adjacency, lambda edge: edge.length_m, needed_m
        )
        return bool(path_m >= needed_m)

    def inlier_edges(self) -> list[Edge]:
        """All odometry edges, and the loops that agree with the optimized poses."""
        if not self._edges:
            return []
        errors = squared_errors(self._poses(), self._measurements())
        return [
            edge
            for edge, error in zip(self._edges, errors, strict=True)
            if error <= INLIER_CHI2 or not edge.is_loop
        ]

    def add_loop_closure(self, loop: Edge) -> None:
        """Add a loop. If it connects two components, the younger one is moved to the older."""
        if self._nodes[loop.a].world_id == self._nodes[loop.b].world_id:
            self._edges.append(loop)
            return
        components = list(self.connected_components())
        component_a, component_b = (
            next(each for each in components if end in each) for end in (loop.a, loop.b)
        )
        self._edges.append(loop)
        T_map_a, T_map_b = self.T_map_keyframe(loop.a), self.T_map_keyframe(loop.b)
        if min(component_a) < min(component_b):
            self._transform_nodes(component_b, T_map_a @ loop.T_a_b @ inverse(T_map_b))
        elif min(component_b) < min(component_a):
            self._transform_nodes(component_a, T_map_b @ inverse(T_map_a @ loop.T_a_b))

    def optimize(self) -> None:
        """Optimize all poses; the oldest node of each component is fixed."""
        if not any(edge.is_loop for edge in self._edges):
            return
        oldest = {min(component) for component in self.connected_components()}
        is_fixed = np.array([number in oldest for number in self._nodes])
        solved = solve(self._poses(), self._measurements(), is_fixed)
        for node, T in zip(list(self._nodes.values()), solved, strict=True):
            self._nodes[node.number] = replace(node, T_map_keyframe=T)

    def remove_redundant_node(self, loop: Edge) -> NodeRemoval:
        """Remove a node, `loop.b`, that is a duplicate of `loop.a`.

        Between two odometry edges its loops are dropped: passed on repeatedly, a loop would be
        counted many times. Otherwise they may be its only connection and are kept. Poses relative
        to it become relative to the older node, whose pose is more stable.
        """
        number = loop.b
        others = [edge for edge in self._edges if number not in (edge.a, edge.b)]
        odometry_edges = [
            edge for edge in self._edges if number in (edge.a, edge.b) and not edge.is_loop
        ]
        if len(odometry_edges) == 2:
            self._edges = [*others, *odometry_edges]
        removal = self.remove_node(number)
        return NodeRemoval(number, loop.a, loop.T_a_b) if loop.a in self._nodes else removal

    def remove_node(self, number: int) -> NodeRemoval:
        """Remove a node. Its neighbors stay connected, and their poses do not change."""
        link, T_map_removed = edge_to_neighbor(number, self._edges), self.T_map_keyframe(number)
        inherited = marginalize_edges(number, self._edges)
        inlier_edges = self.inlier_edges() if any(edge.is_loop for edge in inherited) else []
        adjacency = build_adjacency(edge for edge in inlier_edges if number not in (edge.a, edge.b))
        self._edges = [edge for edge in self._edges if number not in (edge.a, edge.b)]
        del self._nodes[number]
        for edge in inherited:
            if not edge.is_loop or is_informative(edge, adjacency):
                add_to_adjacency(adjacency, edge)
                self._edges.append(edge)
        if link is None:
            return NodeRemoval(number, None, T_map_removed)
        return NodeRemoval(number, link.b, inverse(self.T_map_keyframe(link.b)) @ T_map_removed)

    def _transform_nodes(self, numbers: Iterable[int], T: Array) -> None:
        """Transform the poses of nodes by T (4x4)."""
        for number in numbers:
            node = self._nodes[number]
            self._nodes[number] = replace(
                node, T_map_keyframe=orthonormalize(T @ node.T_map_keyframe)
            )

    def _poses(self) -> Array:
        return np.array([node.T_map_keyframe for node in self._nodes.values()])

    def _measurements(self) -> EdgeMeasurements:
        return collect_measurements(
            self._edges, {number: row for row, number in enumerate(self._nodes)}
        )


@dataclass(frozen=True, eq=False)
class AnchoredPose:
    """A pose of the camera relative to a keyframe.

    Attributes:
        keyframe_number: Number of the last keyframe before it; None if there is none.
        T_keyframe_camera: 4x4 relative to the keyframe, or to the map if there is none.
    """

    keyframe_number: int | None
    T_keyframe_camera: Array

    def re_anchor(self, removal: "NodeRemoval") -> "AnchoredPose":
        """Return the pose relative to the neighbor, if its keyframe is the removed one."""
        if self.keyframe_number != removal.number:
            return self
        return AnchoredPose(removal.neighbor, removal.T_neighbor_removed @ self.T_keyframe_camera)

    def to_map(self, T_map_keyframe: Callable[[int], Array]) -> Array:
        """4x4 T_map_camera, with the keyframes' poses by `T_map_keyframe`."""
        if self.keyframe_number is None:
            return self.T_keyframe_camera
        return np.asarray(T_map_keyframe(self.keyframe_number) @ self.T_keyframe_camera)


class OptimizedTrajectory:
    """Trajectory whose poses are anchored to keyframes and move with them."""

    def __init__(self, graph: "PoseGraph") -> None:
        self._graph = graph
        self._poses: dict[float, AnchoredPose] = {}  # by stamp
        self._stamps_s_by_keyframe: defaultdict[int | None, list[float]] = defaultdict(list)

    def add(self, stamp_s: float, keyframe_number: int, T_keyframe_camera: Array) -> None:
        """Add a frame; it replaces one with the same stamp.

        Args:
            stamp_s: Stamp of the frame, s.
            T_keyframe_camera: 4x4 pose of the optical camera relative to it, m.
        """
        self._poses[stamp_s] = AnchoredPose(keyframe_number, T_keyframe_camera)
        self._stamps_s_by_keyframe[keyframe_number].append(stamp_s)

    def re_anchor(self, removal: "NodeRemoval") -> None:
        """Anchor the poses of a removed keyframe to its neighbor."""
        stamps_s = self._stamps_s_by_keyframe.pop(removal.number, [])
        for stamp_s in stamps_s:
            self._poses[stamp_s] = self._poses[stamp_s].re_anchor(removal)
        self._stamps_s_by_keyframe[removal.neighbor] += stamps_s

    @property
    def trajectory(self) -> Trajectory:
        """Poses by ascending stamps; the first one is the identity."""
        stamps_s = sorted(self._poses)
        poses = np.array(
            [self._poses[stamp_s].to_map(self._graph.T_map_keyframe) for stamp_s in stamps_s]
        )
        if len(poses):
            poses = inverse(poses[0]) @ poses
        return Trajectory(np.array(stamps_s), poses.reshape(-1, 4, 4))
