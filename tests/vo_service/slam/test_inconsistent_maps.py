"""Maps with a right checksum and invalid contents."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vo_service.slam.corner_keyframes import HERE
from tests.vo_service.slam.map_errors import load_error
from vo_service.slam.map_cells import FrameCells
from vo_service.slam.map_file import MapContents, write_map
from vo_service.slam.pose_graph import AnchoredPose, Node

Changed = Callable[[MapContents], MapContents]


def _another_node(contents: MapContents) -> MapContents:
    return replace(contents, nodes=[*contents.nodes, Node(5, 0, HERE, HERE)])


def _edge_to_nowhere(contents: MapContents) -> MapContents:
    return replace(contents, edges=[replace(contents.edges[0], b=9)])


def _another_number(contents: MapContents) -> MapContents:
    first, second = contents.nodes
    return replace(contents, nodes=[first, replace(second, number=5)])


def _edge_to_itself(contents: MapContents) -> MapContents:
    return replace(contents, edges=[replace(contents.edges[0], b=0)])


def _negative_way(contents: MapContents) -> MapContents:
    return replace(contents, edges=[replace(contents.edges[0], length_m=-1.0)])


def _uneven(contents: MapContents) -> MapContents:
    asymmetric = np.eye(6) + 0.1 * np.eye(6, k=1)
    return replace(contents, edges=[replace(contents.edges[0], covariance=asymmetric)])


def _without_focus(contents: MapContents) -> MapContents:
    first, second = contents.keyframes
    flat = replace(second.camera, fx=0.0)
    return replace(contents, keyframes=[first, replace(second, camera=flat)])


def _edge_without_sense(contents: MapContents) -> MapContents:
    return replace(contents, edges=[replace(contents.edges[0], covariance=-np.eye(6))])


def _number_used(contents: MapContents) -> MapContents:
    return replace(contents, next_number=1)


def _skewed(contents: MapContents) -> MapContents:
    first, second = contents.keyframes
    return replace(contents, keyframes=[first, replace(second, T_world_keyframe=2 * np.eye(4))])


def _without_levels(contents: MapContents) -> MapContents:
    first, second = contents.keyframes
    return replace(contents, keyframes=[first, replace(second, packed_points=())])


def _backwards(contents: MapContents) -> MapContents:
    return replace(contents, keyframes=contents.keyframes[::-1])


def _with_frame(contents: MapContents, frame: FrameCells) -> MapContents:
    return replace(contents, cells=replace(contents.cells, frames=[frame]))


def _unknown_cells(contents: MapContents) -> MapContents:
    frame = contents.cells.frames[0]
    return _with_frame(contents, replace(frame, cells=frame.cells + np.int16(2)))


def _cells_nowhere(contents: MapContents) -> MapContents:
    frame = contents.cells.frames[0]
    return _with_frame(contents, replace(frame, anchored_pose=AnchoredPose(9, HERE)))


def _skewed_cells(contents: MapContents) -> MapContents:
    frame = contents.cells.frames[0]
    return _with_frame(contents, replace(frame, anchored_pose=AnchoredPose(0, 2 * HERE)))


def _cells_without_size(contents: MapContents) -> MapContents:
    return replace(contents, cells=replace(contents.cells, resolution_m=0.0))


@pytest.mark.parametrize(
    "change",
    [
        _another_node,
        _another_number,
        _edge_to_nowhere,
        _edge_to_itself,
        _negative_way,
        _uneven,
        _without_focus,
        _edge_without_sense,
        _number_used,
        _skewed,
        _without_levels,
        _backwards,
        _unknown_cells,
        _cells_nowhere,
        _skewed_cells,
        _cells_without_size,
    ],
)
def test_inconsistent_contents_are_rejected(
    tmp_path: Path, contents: MapContents, change: Changed
) -> None:
    write_map(tmp_path / "odd.map", change(contents))
    assert "invalid map: it has" in load_error(tmp_path / "odd.map")
