"""A PLY file holds the mesh bit for bit and is written atomically."""

from pathlib import Path

import numpy as np
import pytest

from tests.full_disk import limit_file_size
from tests.vo_service.reconstruction.ply_reader import read_ply
from vo_service.reconstruction.mesh import Mesh, write_ply


def test_a_written_mesh_is_read_back(seen_ball: Mesh, tmp_path: Path) -> None:
    write_ply(tmp_path / "ball.ply", seen_ball)
    read = read_ply(tmp_path / "ball.ply")
    for part in ("vertices_m", "normals", "colors_rgb", "triangles"):
        np.testing.assert_array_equal(getattr(read, part), getattr(seen_ball, part))


def test_an_empty_mesh_is_written(tmp_path: Path) -> None:
    write_ply(tmp_path / "nothing.ply", Mesh.empty())
    assert len(read_ply(tmp_path / "nothing.ply").vertices_m) == 0


def test_a_full_disk_keeps_the_existing_file(seen_ball: Mesh, tmp_path: Path) -> None:
    file = tmp_path / "ball.ply"
    file.write_bytes(b"before")
    with limit_file_size(10_000), pytest.raises(OSError, match="large"):
        write_ply(file, seen_ball)
    assert [path.name for path in tmp_path.iterdir()] == ["ball.ply"]
    assert file.read_bytes() == b"before"
