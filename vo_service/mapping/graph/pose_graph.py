"""The graph of places: the odometry's motions, the loops, and where the places are by all of them.

Whoever keeps a map asks `is_plausible` of a recognition, adds it with `close`, then `optimise`s.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.geometry import Array, apart, inverse, orthonormal
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.removal import passed_on, tells_something_new, way_to_heir
from vo_service.mapping.graph.routes import connect, neighbours, parts, shortest
from vo_service.mapping.graph.solver import (
    BELIEVED,
    Measurements,
    measurements,
    solve,
    squared_errors,
)

# The odometry may have been off by this much, and by so much for each metre of the way.
PLAUSIBLE_M, PLAUSIBLE_M_PER_M = 0.05, 0.02
PLAUSIBLE_RAD, PLAUSIBLE_RAD_PER_M = np.deg2rad(2.0), np.deg2rad(0.5)


@dataclass(frozen=True, eq=False)
class Node:
    """A place in the graph.

    number         rises from place to place
    world          in which the odometry saw it
    T_world_place  4x4, where the odometry said it was
    T_map_place    4x4, where it is by all that is known
    """

    number: int
    world: int
    T_world_place: Array
    T_map_place: Array


@dataclass(frozen=True, eq=False)
class Removal:
    """A place that was forgotten. What was told from there can be told from its neighbour.

    number               of the place
    neighbour            None where nothing joined it to others: then it was told from the map
    T_neighbour_removed  4x4
    """

    number: int
    neighbour: int | None
    T_neighbour_removed: Array


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

    def add(self, number: int, world: int, T_world_place: Array) -> None:
        """A place that nothing joins to others yet: the first of a world."""
        self._nodes[number] = Node(number, world, T_world_place, T_world_place)

    def extend(self, motion: Edge) -> None:
        """The next place, `motion.b`: the odometry came to it from `motion.a`."""
        before = self._nodes[motion.a]
        self._nodes[motion.b] = Node(
            motion.b,
            before.world,
            orthonormal(before.T_world_place @ motion.T_a_b),
            orthonormal(before.T_map_place @ motion.T_a_b),
        )
        self._edges.append(motion)

    def T_map(self, number: int) -> Array:
        """4x4 pose of a place in the map."""
        return self._nodes[number].T_map_place

    def parts(self) -> list[set[int]]:
        """The places, parted by what is connected; the part with the oldest comes first."""
        return parts(self._nodes, self._edges)

    def is_joined(self, world_a: int, world_b: int) -> bool:
        """True if places of these two worlds are connected."""
        worlds = [{self._nodes[number].world for number in part} for part in self.parts()]
        return any({world_a, world_b} <= together for together in worlds)

    def is_plausible(self, loop: Edge) -> bool:
        """True if the odometry can have been as wrong as this loop says.

        It may be off by so much for each metre of the shortest way between, over edges that are
        believed. Of places that nothing connects, anything is plausible.
        """
        T_expected = inverse(self.T_map(loop.a)) @ self.T_map(loop.b)
        off_m, off_rad = apart(T_expected, loop.T_a_b)
        needed_m = max(
            (off_m - PLAUSIBLE_M) / PLAUSIBLE_M_PER_M,
            (off_rad - PLAUSIBLE_RAD) / PLAUSIBLE_RAD_PER_M,
        )
        if needed_m <= 0.0:
            return True
        around = neighbours(self.believed())
        way_m = shortest(loop.a, loop.b, around, lambda edge: edge.length_m, needed_m)
        return bool(way_m >= needed_m)

    def believed(self) -> list[Edge]:
        """All motions, and the loops that agree with where the places are."""
        if not self._edges:
            return []
        squared = squared_errors(self._poses(), self._measurements())
        return [
            edge
            for edge, error in zip(self._edges, squared, strict=True)
            if error <= BELIEVED or not edge.is_loop
        ]

    def close(self, loop: Edge) -> None:
        """Add a loop. If it joins what was not connected, the younger places come to the older."""
        if self._nodes[loop.a].world == self._nodes[loop.b].world:
            self._edges.append(loop)
            return
        of_a, of_b = (self._part_of(end) for end in (loop.a, loop.b))
        self._edges.append(loop)
        T_map_a, T_map_b = self.T_map(loop.a), self.T_map(loop.b)
        if min(of_a) < min(of_b):
            self._bring(of_b, T_map_a @ loop.T_a_b @ inverse(T_map_b))
        elif min(of_b) < min(of_a):
            self._bring(of_a, T_map_b @ inverse(T_map_a @ loop.T_a_b))

    def optimise(self) -> None:
        """Put every place where all edges agree best; the oldest of each part stays."""
        if not any(edge.is_loop for edge in self._edges):
            return
        oldest = {min(part) for part in self.parts()}
        is_held = np.array([number in oldest for number in self._nodes])
        solved = solve(self._poses(), self._measurements(), is_held)
        for node, T in zip(list(self._nodes.values()), solved, strict=True):
            self._nodes[node.number] = replace(node, T_map_place=T)

    def leave_out(self, loop: Edge) -> Removal:
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
        removal = self.remove(number)
        return Removal(number, loop.a, loop.T_a_b) if loop.a in self._nodes else removal

    def remove(self, number: int) -> Removal:
        """Forget a place. What was connected by it stays connected, and all stay where they are."""
        way, T_map_removed = way_to_heir(number, self._edges), self.T_map(number)
        inherited = passed_on(number, self._edges)
        believed = self.believed() if any(edge.is_loop for edge in inherited) else []
        around = neighbours(edge for edge in believed if number not in (edge.a, edge.b))
        self._edges = [edge for edge in self._edges if number not in (edge.a, edge.b)]
        del self._nodes[number]
        for edge in inherited:
            if not edge.is_loop or tells_something_new(edge, around):
                connect(around, edge)
                self._edges.append(edge)
        if way is None:
            return Removal(number, None, T_map_removed)
        return Removal(number, way.b, inverse(self.T_map(way.b)) @ T_map_removed)

    def _part_of(self, number: int) -> set[int]:
        return next(part for part in self.parts() if number in part)

    def _bring(self, numbers: Iterable[int], T: Array) -> None:
        """Move places, all alike."""
        for number in numbers:
            node = self._nodes[number]
            self._nodes[number] = replace(node, T_map_place=orthonormal(T @ node.T_map_place))

    def _poses(self) -> Array:
        return np.array([node.T_map_place for node in self._nodes.values()])

    def _measurements(self) -> Measurements:
        return measurements(self._edges, {number: row for row, number in enumerate(self._nodes)})
