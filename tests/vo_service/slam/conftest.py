"""Shared fixtures of the SLAM tests."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import inverse
from tests.vo_service.slam.corner_keyframes import (
    BESIDE,
    ELSEWHERE,
    HERE,
    make_keyframe,
)
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import MapKeyframe
from vo_service.slam.map_cells import FrameCells, MapCells
from vo_service.slam.map_file import MapContents
from vo_service.slam.place_recognizer import PlaceRecognizer
from vo_service.slam.pose_graph import AnchoredPose, PoseGraph


@pytest.fixture(scope="session")
def recognizer() -> PlaceRecognizer:
    """Shared, as its results do not depend on earlier views."""
    return PlaceRecognizer()


@pytest.fixture(scope="session")
def here(recognizer: PlaceRecognizer) -> MapKeyframe:
    """Keyframe 0."""
    return make_keyframe(recognizer, HERE)


@pytest.fixture(scope="session")
def elsewhere(recognizer: PlaceRecognizer) -> MapKeyframe:
    """Keyframe 1, without overlap with keyframe 0."""
    return make_keyframe(recognizer, ELSEWHERE, number=1)


@pytest.fixture(scope="session")
def contents(here: MapKeyframe, elsewhere: MapKeyframe) -> MapContents:
    """Two keyframes with an odometry edge and a loop between them."""
    T = inverse(HERE) @ ELSEWHERE
    motion = Edge(0, 1, T, 1e-6 * np.eye(6), is_loop=False, length_m=1.7)
    loop = replace(motion, is_loop=True, length_m=0.0)
    graph = PoseGraph()
    graph.add_node(0, 0, HERE)
    graph.add_odometry_edge(motion)
    graph.add_loop_closure(loop)
    first, second = graph.nodes.values()
    drifted = replace(second, T_world_keyframe=BESIDE)  # the map knows better than the odometry
    frames = [
        FrameCells(AnchoredPose(1, T), np.array([[40, -3, 1], [12, 0, 0], [13, 0, 2]], np.int16)),
        FrameCells(AnchoredPose(None, HERE), np.array([[-5, 7, 0]], np.int16)),
    ]
    cells = MapCells(0.05, frames)
    return MapContents([here, elsewhere], [first, drifted], list(graph.edges), 7, cells)
