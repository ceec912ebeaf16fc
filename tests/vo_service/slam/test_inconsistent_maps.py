"""Maps with a right checksum and invalid contents."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.vo_service.slam.corner_keyframes import HERE
from tests.vo_service.slam.map_errors import load_error
from vo_service.slam.map_file import MapContents, write_map
from vo_service.slam.pose_graph import AnchoredPose, Node


def with_edge(contents: MapContents, **changes: Any) -> MapContents:
    return replace(contents, edges=[replace(contents.edges[0], **changes)])


def with_keyframe(contents: MapContents, **changes: Any) -> MapContents:
    first, second = contents.keyframes
    return replace(contents, keyframes=[first, replace(second, **changes)])


def with_frame(contents: MapContents, **changes: Any) -> MapContents:
    frame = replace(contents.cells.frames[0], **changes)
    return replace(contents, cells=replace(contents.cells, frames=[frame]))


CHANGES: dict[str, Callable[[MapContents], MapContents]] = {
    "another node": lambda m: replace(m, nodes=[*m.nodes, Node(5, 0, HERE, HERE)]),
    "another number": lambda m: replace(m, nodes=[m.nodes[0], replace(m.nodes[1], number=5)]),
    "edge to nowhere": lambda m: with_edge(m, b=9),
    "edge to itself": lambda m: with_edge(m, b=0),
    "negative path": lambda m: with_edge(m, length_m=-1.0),
    "asymmetric covariance": lambda m: with_edge(m, covariance=np.eye(6) + 0.1 * np.eye(6, k=1)),
    "negative covariance": lambda m: with_edge(m, covariance=-np.eye(6)),
    "no focal length": lambda m: with_keyframe(m, camera=replace(m.keyframes[1].camera, fx=0.0)),
    "number is used": lambda m: replace(m, next_number=1),
    "skewed pose": lambda m: with_keyframe(m, T_world_keyframe=2 * np.eye(4)),
    "no levels": lambda m: with_keyframe(m, packed_points=()),
    "backwards": lambda m: replace(m, keyframes=m.keyframes[::-1]),
    "unknown cells": lambda m: with_frame(m, cells=m.cells.frames[0].cells + np.int16(2)),
    "cells nowhere": lambda m: with_frame(m, anchored_pose=AnchoredPose(9, HERE)),
    "skewed cells": lambda m: with_frame(m, anchored_pose=AnchoredPose(0, 2 * HERE)),
    "cells without size": lambda m: replace(m, cells=replace(m.cells, resolution_m=0.0)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_inconsistent_contents_are_rejected(
    tmp_path: Path, contents: MapContents, change: Callable[[MapContents], MapContents]
) -> None:
    write_map(tmp_path / "odd.map", change(contents))
    assert "invalid map: it has" in load_error(tmp_path / "odd.map")
