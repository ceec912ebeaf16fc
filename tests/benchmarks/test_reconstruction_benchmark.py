"""Errors of maps of a virtual room, from synthetic meshes with a known error."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction import measure_map
from drivers.core.geometry import (
    Array,
    Trajectory,
    format_pose_line,
    inverse,
    rigid_transform,
    so3_exp,
    transform_points,
)
from drivers.synthetic.solids import Solid, SolidKind
from vo_service.reconstruction.mesh import Mesh, write_ply

BOX = Solid(SolidKind.BOX, np.eye(4), np.array([1.0, 1.0, 1.0]), ())
# The first camera in the room, and a motion from there.
T_ROOM_CAMERA = rigid_transform(so3_exp([0.1, 0.4, -0.2]), [0.2, 0.3, -0.4])
STAMPS_S = np.arange(10) / 30
WAY = np.array([rigid_transform(np.eye(3), [0.1 * k, 0.0, k * k / 50]) for k in range(10)])
TRUTH = Trajectory(STAMPS_S, T_ROOM_CAMERA @ WAY)


def measured(folder: Path, points_m: Array) -> tuple[float, ...]:
    """Measure a map whose vertices are these points of the room."""
    in_map_m = transform_points(inverse(T_ROOM_CAMERA), points_m).astype(np.float32)
    gray = np.zeros((len(points_m), 3), np.uint8)
    write_ply(folder / "map.ply", Mesh(in_map_m, in_map_m, gray, np.zeros((1, 3), np.int32)))
    (folder / "trajectory.txt").write_text("".join(map(format_pose_line, STAMPS_S, WAY)))
    return measure_map(folder, TRUTH, [BOX])


def test_vertices_are_measured_from_the_nearest_true_surface(tmp_path: Path) -> None:
    points_m = np.array([[1.01, 0, 0], [0, 0.98, 0], [0, 0, -1.0], [0.1, 0.2, 1.0]])
    ate_m, vertices, median_m, *_, within_15mm = measured(tmp_path, points_m)
    assert (vertices, within_15mm) == (4, 0.75)
    assert median_m == pytest.approx(0.005, abs=1e-5)
    assert ate_m == pytest.approx(0.0, abs=1e-5)
