"""Live mapper: its process, requests and results."""

import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.full_disk import limit_file_size
from tests.resource_leaks import child_pids_of, is_alive, resources_in_use
from tests.vo_service.outputs.recorder.recorder_inputs import command_error
from tests.vo_service.reconstruction.ply_reader import read_ply
from tests.vo_service.slam.mapper.wall_sequence import (
    COARSE,
    WALL_M,
    make_wall_update,
    mapper_pid,
    move_along_wall,
    running_mapper,
    save_map,
)
from tests.waiting import wait_until
from vo_service import app
from vo_service.config import Config
from vo_service.config_tables import MapConfig
from vo_service.slam.mapper import client as mapper_package
from vo_service.slam.mapper.client import LiveMapper, open_mapper
from vo_service.types.outputs import NullMapper

pytestmark = pytest.mark.subprocess


@dataclass
class SavedWallMap:
    """A mapper with three keyframes of the wall, and its saved map."""

    mapper: LiveMapper
    map: Path


@pytest.fixture(scope="module")
def saved_wall(kernels: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SavedWallMap]:
    with running_mapper(tmp_path_factory.mktemp("state") / "maps") as opened:
        move_along_wall(opened, 3)
        yield SavedWallMap(opened, save_map(opened, "wall"))


def test_a_mesh_has_the_seen_surfaces_in_odom(saved_wall: SavedWallMap) -> None:
    places_m = read_ply(saved_wall.map).vertices_m
    np.testing.assert_allclose(places_m[:, 0], WALL_M, atol=COARSE.voxel_m)  # x is forward
    assert places_m[:, 1].min() < -1.0 < 0.5 < places_m[:, 1].max()  # y is left; it went right
    assert np.abs(places_m[:, 2]).max() < 1.0


def test_a_saved_map_is_kept_and_keyframes_stay_for_the_next(saved_wall: SavedWallMap) -> None:
    assert saved_wall.mapper.warning == ""
    assert saved_wall.mapper.state.mesh_keyframes == 3
    assert "map 'wall' already exists" in command_error(lambda: saved_wall.mapper.save("wall"))


def test_keyframes_are_those_of_this_epoch_up_to_the_current_limit(tmp_path: Path) -> None:
    with running_mapper(tmp_path) as opened:
        published = command_error(lambda: opened.save("wall"))
        assert published == "not-possible: the map is empty: no frame has been tracked yet"
        move_along_wall(opened, 2)
        move_along_wall(opened, 3, epoch=1)
        opened.configure(replace(COARSE, max_mb=0))  # less than any configuration file may say
        wait_until(lambda: opened.state.mesh_keyframes == 1)


@pytest.fixture
def endless_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes that are still being computed when the test kills their process."""
    function = "tests.vo_service.slam.mapper.endless_mesh_process:run"
    monkeypatch.setattr(
        mapper_package, "WORKER_SPEC", replace(mapper_package.WORKER_SPEC, function=function)
    )


@pytest.mark.usefixtures("endless_meshes")
def test_only_one_mesh_is_computed_at_a_time_and_a_killed_job_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running_mapper(tmp_path / "maps") as opened:
        move_along_wall(opened, 1)
        opened.save("wall")
        assert "a map is already being saved" in command_error(lambda: opened.save("other"))
        wait_until(lambda: bool(child_pids_of(mapper_pid())), "the process that makes it")
        os.kill(child_pids_of(mapper_pid())[0], signal.SIGKILL)
        wait_until(lambda: not opened.state.saving)
        assert "wall.ply: the mesh process was killed" in opened.warning
        assert opened.state.saved == ""
        assert opened.state.mesh_keyframes == 1
    assert [record.levelname for record in caplog.records] == ["ERROR"]


@pytest.mark.usefixtures("endless_meshes")
def test_a_killed_process_restarts_with_an_empty_map_and_a_warning(tmp_path: Path) -> None:
    with running_mapper(tmp_path / "maps") as opened:
        move_along_wall(opened, 3)
        opened.save("wall")
        first = mapper_pid()
        wait_until(lambda: bool(child_pids_of(first)), "the process that makes it")
        (maker,) = child_pids_of(first)
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: "is restarted with an empty map" in opened.warning)
        wait_until(lambda: opened.is_ready and first != mapper_pid())
        assert opened.warning.endswith("wall.ply was interrupted")
        assert (opened.state.mesh_keyframes, opened.state.saving) == (0, "")
        opened.on_update(
            make_wall_update(9, 0.4)
        )  # where it stood before: a camera that stands has a map again
        wait_until(lambda: opened.state.mesh_keyframes == 1)
        wait_until(lambda: not is_alive(maker))
    assert not list(tmp_path.glob("maps/*"))


def test_closing_cancels_a_mesh_and_leaves_no_incomplete_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running_mapper(tmp_path / "maps"):
        pass  # what is loaded once stays
    before = resources_in_use()
    with running_mapper(tmp_path / "maps") as opened:
        move_along_wall(opened, 2)
        file = opened.save("wall").saving
    assert resources_in_use() <= before
    assert f"saving {file} is cancelled" in caplog.text
    assert not [path for path in tmp_path.glob("maps/*") if path.suffix != ".ply"]  # it was whole


def test_an_unusable_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "maps").write_text("a file")
    with running_mapper(tmp_path / "maps") as opened:
        wait_until(lambda: "maps: cannot be used" in opened.warning)
        (tmp_path / "maps").unlink()
        wait_until(lambda: opened.warning == "")


def test_the_service_continues_without_memory_for_the_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    with limit_file_size(1000):
        opened = open_mapper(COARSE)
    assert isinstance(opened, NullMapper)
    assert opened.warning == "map: disabled: no shared memory: File too large"
    assert command_error(lambda: opened.save("x")).startswith("not-possible: map: disabled")


@pytest.mark.slow
def test_a_disabled_map_refuses_with_the_reason() -> None:
    opened = app.open_mapper(Config(map=MapConfig(enabled=False)))
    assert opened.warning == ""
    assert command_error(lambda: opened.save("x")).endswith("the map is disabled (map.enabled)")
