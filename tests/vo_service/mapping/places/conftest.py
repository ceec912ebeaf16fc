"""What several tests of places need, made once."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.geometry import inverse
from tests.vo_service.mapping.places.corner_places import BESIDE, ELSEWHERE, HERE, place_at
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import PoseGraph
from vo_service.mapping.places.map_file import MapContents
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.recognition import Recogniser


@pytest.fixture(scope="session")
def recogniser() -> Recogniser:
    """Gives the same whatever it has seen before."""
    return Recogniser()


@pytest.fixture(scope="session")
def here(recogniser: Recogniser) -> Place:
    """Place 0."""
    return place_at(recogniser, HERE)


@pytest.fixture(scope="session")
def elsewhere(recogniser: Recogniser) -> Place:
    """Place 1, with nothing in view that place 0 has."""
    return place_at(recogniser, ELSEWHERE, number=1)


@pytest.fixture(scope="session")
def contents(here: Place, elsewhere: Place) -> MapContents:
    """Two places, a motion and a loop between them."""
    T = inverse(HERE) @ ELSEWHERE
    motion = Edge(0, 1, T, 1e-6 * np.eye(6), is_loop=False, length_m=1.7)
    loop = replace(motion, is_loop=True, length_m=0.0)
    graph = PoseGraph()
    graph.add(0, 0, HERE)
    graph.extend(motion)
    graph.close(loop)
    first, second = graph.nodes.values()
    drifted = replace(second, T_world_place=BESIDE)  # the map knows better than the odometry
    return MapContents([here, elsewhere], [first, drifted], list(graph.edges), 7)
