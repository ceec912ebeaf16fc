import hashlib
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.core import InputError, UserFacingError
from tests.vo_service.slam.map_errors import load_error
from vo_service.slam.map_cells import NO_MAP_CELLS
from vo_service.slam.map_file import HEADER, MAGIC, MapContents, read_map, write_map


@pytest.fixture
def saved(tmp_path: Path, contents: MapContents) -> Path:
    path = tmp_path / "home.map"
    write_map(path, contents)
    return path


def with_new_checksum(data: bytes) -> bytes:
    """The file with a new header."""
    body = data[HEADER.size :]
    return HEADER.pack(MAGIC, 1, len(body), hashlib.sha256(body).digest()) + body


def test_a_map_is_restored_unchanged(saved: Path, contents: MapContents) -> None:
    again = read_map(saved)
    assert again.next_number == 7
    for was, now in zip(contents.keyframes, again.keyframes, strict=True):
        assert (now.number, now.world_id, now.stamp_s) == (was.number, was.world_id, was.stamp_s)
        assert now.camera == was.camera
        assert np.array_equal(now.T_world_keyframe, was.T_world_keyframe)
        assert np.array_equal(now.vlad_descriptor, was.vlad_descriptor)
        for saved_points, loaded_points in zip(
            was.alignment_points, now.alignment_points, strict=True
        ):
            for field, loaded in zip(saved_points, loaded_points, strict=True):
                assert np.array_equal(field, loaded)
    for edge, own_edges in zip(contents.edges, again.edges, strict=True):
        assert (own_edges.a, own_edges.b, own_edges.is_loop, own_edges.length_m) == (
            edge.a, edge.b, edge.is_loop, edge.length_m,
        )  # fmt: skip
        assert np.array_equal(own_edges.T_a_b, edge.T_a_b)
        assert np.array_equal(own_edges.covariance, edge.covariance)
    for node, its_node in zip(contents.nodes, again.nodes, strict=True):
        assert (its_node.number, its_node.world_id) == (node.number, node.world_id)
        assert np.array_equal(its_node.T_map_keyframe, node.T_map_keyframe)
        assert np.array_equal(its_node.T_world_keyframe, node.T_world_keyframe)
    assert again.cells.resolution_m == contents.cells.resolution_m
    for frame, its_frame in zip(contents.cells.frames, again.cells.frames, strict=True):
        was_at, is_at = frame.anchored_pose, its_frame.anchored_pose
        assert is_at.keyframe_number == was_at.keyframe_number
        assert np.array_equal(is_at.T_keyframe_camera, was_at.T_keyframe_camera)
        assert np.array_equal(its_frame.cells, frame.cells)


def test_a_map_without_cells_or_keyframes_is_valid(tmp_path: Path, contents: MapContents) -> None:
    write_map(tmp_path / "old.map", replace(contents, cells=NO_MAP_CELLS))
    assert b"cells/" not in (tmp_path / "old.map").read_bytes()
    assert read_map(tmp_path / "old.map").cells is NO_MAP_CELLS
    write_map(tmp_path / "empty.map", MapContents([], [], [], 0))
    assert read_map(tmp_path / "empty.map") == MapContents([], [], [], 0)


def test_covariances_with_rounding_errors_are_restored(
    contents: MapContents, tmp_path: Path
) -> None:
    asymmetric = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])
    asymmetric[0, 3], asymmetric[3, 0] = 1e-22, -3e-22
    edges = [replace(edge, covariance=asymmetric) for edge in contents.edges]
    write_map(tmp_path / "uneven", replace(contents, edges=edges))
    again = read_map(tmp_path / "uneven").edges
    assert all(np.array_equal(edge.covariance, asymmetric) for edge in again)


def test_a_map_is_readable_only_by_its_owner(saved: Path, contents: MapContents) -> None:
    saved.chmod(0o644)
    write_map(saved, contents)
    assert stat.S_IMODE(saved.stat().st_mode) == 0o600
    assert list(saved.parent.iterdir()) == [saved]


def test_the_same_map_gives_the_same_bytes(saved: Path, tmp_path: Path) -> None:
    write_map(tmp_path / "again.map", read_map(saved))
    assert (tmp_path / "again.map").read_bytes() == saved.read_bytes()


def test_the_old_map_stays_if_the_disk_is_full(saved: Path) -> None:
    before = saved.read_bytes()
    (saved.parent / ".home.map.part").mkdir()
    with pytest.raises(UserFacingError, match="cannot be written"):
        write_map(saved, MapContents([], [], [], 0))
    assert saved.read_bytes() == before


@pytest.mark.parametrize("data", [b"", b"ply\nformat ascii 1.0\n" * 9, MAGIC, MAGIC + bytes(44)])
def test_another_file_is_rejected_as_a_map(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other"
    path.write_bytes(data)
    assert "not a kinect-vo map" in load_error(path) or "version 0" in load_error(path)


def test_a_missing_or_irregular_file_is_rejected(tmp_path: Path) -> None:
    assert "No such file" in load_error(tmp_path / "nowhere.map")
    assert "it is a folder" in load_error(tmp_path)


def test_another_version_or_length_is_refused(saved: Path) -> None:
    data = bytearray(saved.read_bytes())
    saved.write_bytes(data[: len(data) // 2])
    assert "damaged map: wrong length" in load_error(saved)
    data[16] = 2
    saved.write_bytes(data)
    assert "map version 2 is not supported, only 1" in load_error(saved)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 7))
def test_a_flipped_bit_is_detected(saved: Path, where: float, bit: int) -> None:
    data = saved.read_bytes()
    turned = bytearray(data)
    turned[int(where * len(data))] ^= 1 << bit
    damaged = saved.with_name("damaged.map")
    damaged.write_bytes(turned)
    load_error(damaged)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 3500), st.integers(1, 255))
def test_a_changed_index_is_refused_even_with_the_right_checksum(
    saved: Path, where: int, change: int
) -> None:
    data = bytearray(saved.read_bytes())
    data[HEADER.size + where] ^= change
    changed = saved.with_name("changed.map")
    changed.write_bytes(with_new_checksum(bytes(data)))
    try:
        read_map(changed)
    except InputError:
        load_error(changed)
