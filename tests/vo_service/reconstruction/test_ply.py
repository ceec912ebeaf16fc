"""A PLY file holds the mesh bit for bit and is written atomically."""

from pathlib import Path

import numpy as np
import pytest

from tests.full_disk import limit_file_size
from tests.vo_service.reconstruction.ply_reader import read_ply
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.ply import write_ply


def test_what_is_read_is_what_was_written(seen_ball: Mesh, tmp_path: Path) -> None:
    write_ply(tmp_path / "ball.ply", seen_ball)
    read = read_ply(tmp_path / "ball.ply")
    for part in ("vertices_m", "normals", "colors_rgb", "triangles"):
        np.testing.assert_array_equal(getattr(read, part), getattr(seen_ball, part))


def test_a_mesh_of_nothing_is_a_file_too(tmp_path: Path) -> None:
    write_ply(tmp_path / "nothing.ply", Mesh.empty())
    assert len(read_ply(tmp_path / "nothing.ply").vertices_m) == 0


def test_a_full_disk_leaves_the_file_that_was_there(seen_ball: Mesh, tmp_path: Path) -> None:
    file = tmp_path / "ball.ply"
    file.write_bytes(b"before")
    with limit_file_size(10_000), pytest.raises(OSError, match="large"):
        write_ply(file, seen_ball)
    assert [path.name for path in tmp_path.iterdir()] == ["ball.ply"]
    assert file.read_bytes() == b"before"
