"""Map store: atomic writes, private files, limited size."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core import UserFacingError
from vo_service.slam.mapper.map_store import MapStore

TOTAL = 10_000


def file_of(size: int) -> Callable[[Path], None]:
    def fill(path: Path) -> None:
        path.write_bytes(b"m" * size)

    return fill


@pytest.fixture
def maps(tmp_path: Path) -> MapStore:
    return MapStore(tmp_path / "state" / "maps")


def names(maps: MapStore) -> list[str]:
    """Names of all files."""
    return sorted(path.name for path in maps.folder.iterdir())


def test_a_map_gets_its_name_when_complete(maps: MapStore) -> None:
    def fill(path: Path) -> None:
        assert maps.names == set()
        file_of(10)(path)

    assert maps.write(maps.mesh_file("kitchen.1"), TOTAL, fill) == maps.folder / "kitchen.1.ply"
    assert maps.names == {"kitchen.1"}
    assert names(maps) == ["kitchen.1.ply"]
    assert maps.folder.stat().st_mode & 0o777 == 0o700


def test_only_the_oldest_maps_are_deleted(maps: MapStore) -> None:
    for age_s, name in enumerate(("new", "old")):
        maps.write(maps.mesh_file(name), TOTAL, file_of(4000))
        os.utime(maps.mesh_file(name), (1000 - age_s, 1000 - age_s))
    (maps.folder / "notes.txt").write_text("mine")
    maps.write(maps.mesh_file("newest"), TOTAL, file_of(4000))
    assert names(maps) == ["new.ply", "newest.ply", "notes.txt"]


def test_a_map_larger_than_the_quota_deletes_no_other(maps: MapStore) -> None:
    maps.write(maps.mesh_file("old"), TOTAL, file_of(4000))
    with pytest.raises(UserFacingError, match=r"huge.ply: it needs .* more than map.total_mb"):
        maps.write(maps.mesh_file("huge"), TOTAL, file_of(TOTAL + 1))
    assert names(maps) == ["old.ply"]


def test_partial_maps_of_a_killed_process_are_removed(maps: MapStore) -> None:
    left = maps.folder / "kitchen.part"
    left.mkdir(parents=True)
    (left / "kitchen.ply").write_bytes(b"half")
    maps.write(maps.mesh_file("kitchen"), TOTAL, file_of(10))
    assert names(maps) == ["kitchen.ply"]


def test_partial_maps_of_another_service_are_kept(maps: MapStore) -> None:
    def fill(path: Path) -> None:
        MapStore(maps.folder).clean_up()
        with pytest.raises(UserFacingError, match="File exists"):
            MapStore(maps.folder).write(maps.mesh_file("kitchen"), TOTAL, file_of(1))
        file_of(10)(path)

    maps.write(maps.mesh_file("kitchen"), TOTAL, fill)
    assert maps.mesh_file("kitchen").stat().st_size == 10
