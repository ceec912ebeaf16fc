"""The graph of places: the odometry's motions, the loops, and where the places are by all of them.

Whoever keeps a map asks `is_plausible` of a recognition, adds it with `close`, then `optimise`s.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.geometry import Array, inverse, orthonormalize, pose_distance
from vo_service.slam.pose_graph.connectivity import (
    add_to_adjacency,
    build_adjacency,
    connected_components,
    shortest_path_length,
)
from vo_service.slam.pose_graph.edges import Edge
from vo_service.slam.pose_graph.node_removal import (
    edge_to_neighbor,
    is_informative,
    marginalize_edges,
)
from vo_service.slam.pose_graph.solver import (
    INLIER_CHI2,
    EdgeMeasurements,
    collect_measurements,
    solve,
    squared_errors,
)

# The odometry may have been off by this much, and by so much for each metre of the way.
MAX_DRIFT_M, MAX_DRIFT_M_PER_M = 0.05, 0.02
MAX_DRIFT_RAD, MAX_DRIFT_RAD_PER_M = np.deg2rad(2.0), np.deg2rad(0.5)


@dataclass(frozen=True, eq=False)
class Node:
    """A place in the graph.

    number         rises from place to place
    world          in which the odometry saw it
    T_world_place  4x4, where the odometry said it was
    T_map_place    4x4, where it is by all that is known
    """

    number: int
    world_id: int
    T_world_keyframe: Array
    T_map_keyframe: Array


@dataclass(frozen=True, eq=False)
class NodeRemoval:
    """A place that was forgotten. What was told from there can be told from its neighbour.

    number               of the place
    neighbour            None where nothing joined it to others: then it was told from the map
    T_neighbour_removed  4x4
    """

    number: int
    neighbor: int | None
    T_neighbor_removed: Array


class PoseGraph:
    """Places and what joins them.

    All that is connected has one frame, map: there the oldest place stays where it is. Places that
    nothing joins to the oldest have a frame of their own, until a loop does.
    """

    def __init__(self, nodes: Iterable[Node] = (), edges: Iterable[Edge] = ()) -> None:
        """A graph that was kept, or a new one."""
        self._nodes = {node.number: node for node in nodes}
        self._edges = list(edges)

    @property
    def nodes(self) -> Mapping[int, Node]:
        """The places by number."""
        return self._nodes

    @property
    def edges(self) -> Sequence[Edge]:
        """Motions and loops, in the order in which they came."""
        return self._edges

    def add_node(self, number: int, world_id: int, T_world_keyframe: Array) -> None:
        """A place that nothing joins to others yet: the first of a world."""
        self._nodes[number] = Node(number, world_id, T_world_keyframe, T_world_keyframe)

    def add_odometry_edge(self, edge: Edge) -> None:
        """The next place, `motion.b`: the odometry came to it from `motion.a`."""
        before = self._nodes[edge.a]
        self._nodes[edge.b] = Node(
            edge.b,
            before.world_id,
            orthonormalize(before.T_world_keyframe @ edge.T_a_b),
            orthonormalize(before.T_map_keyframe @ edge.T_a_b),
        )
        self._edges.append(edge)

    def T_map_keyframe(self, number: int) -> Array:
        """4x4 pose of a place in the map."""
        return self._nodes[number].T_map_keyframe

    def connected_components(self) -> list[set[int]]:
        """The places, parted by what is connected; the part with the oldest comes first."""
        return connected_components(self._nodes, self._edges)

    def are_connected(self, world_a: int, world_b: int) -> bool:
        """True if places of these two worlds are connected."""
        worlds = [
            {self._nodes[number].world_id for number in part}
            for part in self.connected_components()
        ]
        return any({world_a, world_b} <= together for together in worlds)

    def is_plausible(self, loop: Edge) -> bool:
        """True if the odometry can have been as wrong as this loop says.

        It may be off by so much for each metre of the shortest way between, over edges that are
        believed. Of places that nothing connects, anything is plausible.
        """
        T_expected = inverse(self.T_map_keyframe(loop.a)) @ self.T_map_keyframe(loop.b)
        off_m, off_rad = pose_distance(T_expected, loop.T_a_b)
        needed_m = max(
            (off_m - MAX_DRIFT_M) / MAX_DRIFT_M_PER_M,
            (off_rad - MAX_DRIFT_RAD) / MAX_DRIFT_RAD_PER_M,
        )
        if needed_m <= 0.0:
            return True
        around = build_adjacency(self.inlier_edges())
        way_m = shortest_path_length(loop.a, loop.b, around, lambda edge: edge.length_m, needed_m)
        return bool(way_m >= needed_m)

    def inlier_edges(self) -> list[Edge]:
        """All motions, and the loops that agree with where the places are."""
        if not self._edges:
            return []
        squared = squared_errors(self._poses(), self._measurements())
        return [
            edge
            for edge, error in zip(self._edges, squared, strict=True)
            if error <= INLIER_CHI2 or not edge.is_loop
        ]

    def add_loop_closure(self, loop: Edge) -> None:
        """Add a loop. If it joins what was not connected, the younger places come to the older."""
        if self._nodes[loop.a].world_id == self._nodes[loop.b].world_id:
            self._edges.append(loop)
            return
        of_a, of_b = (self._component_of(end) for end in (loop.a, loop.b))
        self._edges.append(loop)
        T_map_a, T_map_b = self.T_map_keyframe(loop.a), self.T_map_keyframe(loop.b)
        if min(of_a) < min(of_b):
            self._transform_nodes(of_b, T_map_a @ loop.T_a_b @ inverse(T_map_b))
        elif min(of_b) < min(of_a):
            self._transform_nodes(of_a, T_map_b @ inverse(T_map_a @ loop.T_a_b))

    def optimize(self) -> None:
        """Put every place where all edges agree best; the oldest of each part stays."""
        if not any(edge.is_loop for edge in self._edges):
            return
        oldest = {min(part) for part in self.connected_components()}
        is_held = np.array([number in oldest for number in self._nodes])
        solved = solve(self._poses(), self._measurements(), is_held)
        for node, T in zip(list(self._nodes.values()), solved, strict=True):
            self._nodes[node.number] = replace(node, T_map_keyframe=T)

    def remove_redundant_node(self, loop: Edge) -> NodeRemoval:
        """Forget a place, `loop.b`, that tells nothing that `loop.a` has not told.

        The way past it stays, its loops go with it: passed on again and again, a loop would be
        counted for as many. Where no way leads past, they are all that joins it to others, and
        stay. What was told from there can be told from the older place, which does not go with
        every correction of the newest.
        """
        number = loop.b
        others = [edge for edge in self._edges if number not in (edge.a, edge.b)]
        motions = [edge for edge in self._edges if number in (edge.a, edge.b) and not edge.is_loop]
        if len(motions) == 2:
            self._edges = [*others, *motions]
        removal = self.remove_node(number)
        return NodeRemoval(number, loop.a, loop.T_a_b) if loop.a in self._nodes else removal

    def remove_node(self, number: int) -> NodeRemoval:
        """Forget a place. What was connected by it stays connected, and all stay where they are."""
        way, T_map_removed = edge_to_neighbor(number, self._edges), self.T_map_keyframe(number)
        inherited = marginalize_edges(number, self._edges)
        believed = self.inlier_edges() if any(edge.is_loop for edge in inherited) else []
        around = build_adjacency(edge for edge in believed if number not in (edge.a, edge.b))
        self._edges = [edge for edge in self._edges if number not in (edge.a, edge.b)]
        del self._nodes[number]
        for edge in inherited:
            if not edge.is_loop or is_informative(edge, around):
                add_to_adjacency(around, edge)
                self._edges.append(edge)
        if way is None:
            return NodeRemoval(number, None, T_map_removed)
        return NodeRemoval(number, way.b, inverse(self.T_map_keyframe(way.b)) @ T_map_removed)

    def _component_of(self, number: int) -> set[int]:
        return next(part for part in self.connected_components() if number in part)

    def _transform_nodes(self, numbers: Iterable[int], T: Array) -> None:
        """Move places, all alike."""
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
