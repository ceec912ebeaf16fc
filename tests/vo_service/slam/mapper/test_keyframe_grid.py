"""The occupancy grid of the mapper: sent on change, with a rate limit."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform
from drivers.core.process.record_ring import RecordRingWriter
from tests.vo_service.fakes import FakeClock
from tests.vo_service.navigation.views import mounted, wall_on_floor
from vo_service.config_tables import MapConfig
from vo_service.slam.map_cells import NO_MAP_CELLS, FrameCells, MapCells
from vo_service.slam.mapper import keyframe_grid as module
from vo_service.slam.mapper.keyframe_grid import KeyframeGrid
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.messages import MapperMessage, MapperWorkerConfig
from vo_service.slam.pose_graph import AnchoredPose, NodeRemoval
from vo_service.types.occupancy_grid import NO_GRID, OccupancyGrid

MOUNT = mounted(0.5, 10.0)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    clock = FakeClock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def at(grid: KeyframeGrid, x_m: float) -> MeshKeyframe:
    """A keyframe with a wall 2 m ahead."""
    T = rigid_transform(np.eye(3), (x_m, 0.0, 0.0)) @ MOUNT
    frame = wall_on_floor(MOUNT, 2.0)
    cells = grid.mapper.cells(frame, T)
    pose = AnchoredPose(None, T)
    return MeshKeyframe(0, T, frame.camera, 5000.0, b"", b"", pose, cells)


class ShiftedMap:
    """A map whose keyframes are all at a place."""

    def __init__(self, y_m: float = 0.0, is_localized: bool = True) -> None:
        self.is_localized = is_localized
        self._T_map_keyframe = rigid_transform(np.eye(3), (0.0, y_m, 0.0))

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        return self._T_map_keyframe @ pose.T_keyframe_camera


MAP, UNKNOWN_MAP = ShiftedMap(), ShiftedMap(is_localized=False)


@pytest.fixture
def config(tmp_path: Path) -> Iterator[MapperWorkerConfig]:
    ring = RecordRingWriter("trial", 5.0, 1 << 16)
    yield MapperWorkerConfig(
        ring.memory, 0, tmp_path, MapConfig(publish_hz=2.0), T_base_camera=MOUNT
    )
    ring.close()


def test_a_grid_is_sent_when_it_has_changed_at_most_so_often(
    clock: FakeClock, config: MapperWorkerConfig
) -> None:
    sent: list[MapperMessage] = []
    grid = KeyframeGrid(config, sent.append)
    keyframes = [at(grid, 0.0)]
    grid.send_if_due(keyframes, MAP)
    assert not sent  # nothing was marked
    grid.mark_stale()
    grid.send_if_due(keyframes, MAP)
    assert len(sent) == 1
    keyframes.append(at(grid, 0.5))
    grid.mark_stale()
    grid.send_if_due(keyframes, MAP)
    assert len(sent) == 1  # too early
    clock.now_s += 0.6
    grid.send_if_due(keyframes, MAP)
    assert len(sent) == 2
    clock.now_s += 0.6
    grid.mark_stale()
    grid.send_if_due(keyframes, MAP)
    assert len(sent) == 2  # the same cells
    clock.now_s += 0.6
    grid.mark_stale()
    grid.send_if_due(keyframes, ShiftedMap(3.0))
    first, moved = sent[1], sent[2]
    assert isinstance(first, OccupancyGrid)
    assert isinstance(moved, OccupancyGrid)
    assert moved.origin_xy_m[1] == pytest.approx(first.origin_xy_m[1] + 3.0)
    np.testing.assert_array_equal(moved.cells, first.cells)


def test_a_loaded_map_brings_its_cells_and_the_robot_adds_to_them_once_it_knows_where_it_is(
    config: MapperWorkerConfig,
) -> None:
    grid = KeyframeGrid(config, lambda _: None)
    there, here = at(grid, -3.0), at(grid, 0.0)
    saved = grid.contents([there], MAP)
    alone = grid.render([there], MAP)
    both = grid.render([there, here], MAP)
    grid = KeyframeGrid(config, lambda _: None)
    assert grid.load(saved) == ""
    for keyframes, the_map, expected in (
        ([], UNKNOWN_MAP, alone),
        ([here], UNKNOWN_MAP, alone),
        ([here], MAP, both),
    ):
        assert grid.render(keyframes, the_map).equals(expected)


def test_of_a_place_that_is_seen_again_the_new_cells_are_saved(config: MapperWorkerConfig) -> None:
    grid = KeyframeGrid(config, lambda _: None)
    grid.load(grid.contents([at(grid, -3.0), at(grid, 0.0)], MAP))
    again = at(grid, 0.02)
    saved = grid.contents([again], MAP)
    assert [each.anchored_pose.T_keyframe_camera[0, 3] for each in saved.frames] == [-3.0, 0.02]
    assert len(grid.contents([again], UNKNOWN_MAP).frames) == 2  # `again` is anywhere
    assert len(grid.contents([], MAP).frames) == 2


def test_loaded_cells_follow_the_removal_of_a_keyframe(config: MapperWorkerConfig) -> None:
    grid = KeyframeGrid(config, lambda _: None)
    cells = at(grid, 0.0).cells
    grid.load(MapCells(0.05, [FrameCells(AnchoredPose(7, MOUNT), cells)]))
    before = grid.render([], MAP)
    grid.re_anchor(NodeRemoval(7, 3, rigid_transform(np.eye(3), (0.0, 1.0, 0.0))))
    after = grid.render([], MAP)
    assert after.origin_xy_m[1] == pytest.approx(before.origin_xy_m[1] + 1.0)
    ((pose, _),) = [(each.anchored_pose, each.cells) for each in grid.contents([], MAP).frames]
    assert pose.keyframe_number == 3


def test_cells_that_do_not_fit_are_not_loaded(config: MapperWorkerConfig) -> None:
    grid = KeyframeGrid(config, lambda _: None)
    frame = FrameCells(AnchoredPose(None, MOUNT), at(grid, 0.0).cells)
    assert "no cells" in grid.load(NO_MAP_CELLS)
    assert "map.resolution_m = 0.1" in grid.load(MapCells(0.1, [frame]))
    assert grid.render([], MAP) is NO_GRID
    far = np.concatenate([frame.cells, np.array([[32000, -32000, 1]], np.int16)])
    assert grid.load(MapCells(0.05, [replace(frame, cells=far)])) == ""
    expected = KeyframeGrid(config, lambda _: None).render([at(grid, 0.0)], MAP)
    assert grid.render([], MAP).equals(expected)
