"""Mapper worker with frames of the ring, without the process."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform, so3_exp
from drivers.core.process.record_ring import RecordRingReader, RecordRingWriter
from tests.vo_service.navigation.views import mounted
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam.corner_trajectory import (
    make_loop_closer,
    make_update,
    odometry_pose,
    true_pose,
)
from tests.vo_service.slam.mapper.wall_sequence import COARSE
from vo_service.frame_packing import write_frame
from vo_service.mapper_process import fuse_keyframes
from vo_service.slam.keyframe_selection import OdometryConstraint
from vo_service.slam.map_file import write_map
from vo_service.slam.mapper import worker as desk_module
from vo_service.slam.mapper.loop_closure_worker import LoopClosureWorker
from vo_service.slam.mapper.messages import (
    LoadMapResult,
    MapperMessage,
    MapperWorkerConfig,
    RelocalizationQuery,
    SaveMapRequest,
    SaveMapResult,
)
from vo_service.slam.mapper.worker import MapperWorker
from vo_service.slam.relocalization import AsynchronousLoopClosure, RelocalizationResult
from vo_service.types.occupancy_grid import OCCUPIED, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

WITH_LOOP_CLOSURE = replace(COARSE, loop_closure=True)
CONSTRAINT = OdometryConstraint(np.zeros(6), np.eye(6) * 1e-5, 0.15)


@pytest.fixture
def ring() -> Iterator[RecordRingWriter]:
    writer = RecordRingWriter("trial", 5.0, 1 << 24)
    yield writer
    writer.close()


def put(
    ring: RecordRingWriter,
    n: int,
    attachment: OdometryConstraint | RelocalizationQuery,
    T_odom_start: Array,
    state: TrackingState = TrackingState.TRACKING,
) -> None:
    """Write the n-th keyframe, in an `odom` frame with any pose."""
    seen = replace(make_update(n, state), T_world_camera=T_odom_start @ odometry_pose(n))
    write_frame(ring, seen, attachment)


def take_in(worker: LoopClosureWorker, ring: RecordRingWriter) -> None:
    """Process all frames of the ring."""
    reader = RecordRingReader(ring.memory)
    for number in range(ring.record_count):
        record = reader.read_record(number)
        assert record is not None
        worker.process_record(record)


def test_the_last_queried_frame_gets_one_result(ring: RecordRingWriter) -> None:
    received: list[MapperMessage] = []
    worker = LoopClosureWorker(WITH_LOOP_CLOSURE, received.append)
    attachments: list[OdometryConstraint | RelocalizationQuery] = [
        CONSTRAINT,
        RelocalizationQuery(),
        RelocalizationQuery(),
    ]
    for n, attachment in enumerate(attachments):
        put(ring, n, attachment, np.eye(4))
    take_in(worker, ring)
    worker.answer_query()
    worker.answer_query()
    assert [message.seq for message in received if isinstance(message, RelocalizationResult)] == [2]


def test_a_mesh_uses_the_keyframe_poses_of_the_map(
    ring: RecordRingWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    monkeypatch.setattr(desk_module, "MeshJob", lambda file, make, leave: made.append(make))
    write_map(tmp_path / "corner.keyframes", make_loop_closer(3).contents)
    config = MapperWorkerConfig(ring.memory, 0, tmp_path, replace(WITH_LOOP_CLOSURE, load="corner"))
    worker = MapperWorker(config, lambda message: None, lambda: None, fuse_keyframes)
    odom = rigid_transform(so3_exp([0.0, 0.0, 2.0]), [7.0, -3.0, 1.0])
    for n in (2, 4):
        put(ring, n, CONSTRAINT, odom)
    put(ring, 6, RelocalizationQuery(), odom, TrackingState.LOST)  # no pose to make a surface by
    worker.process_frames()
    worker.handle(SaveMapRequest("other"))
    _, _, keyframes, _, _ = made[0].args
    assert len(keyframes) == 2
    for n, keyframe in zip((2, 4), keyframes, strict=True):
        assert np.allclose(keyframe.T_odom_camera[:3, 3], true_pose(n)[:3, 3], atol=0.03)


def test_a_loaded_map_brings_the_grid_that_was_saved(
    ring: RecordRingWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk_module, "MeshJob", lambda file, make, leave: None)
    mount = mounted(0.5, 10.0)
    config = MapperWorkerConfig(ring.memory, 0, tmp_path, WITH_LOOP_CLOSURE, T_base_camera=mount)
    received: list[MapperMessage] = []
    worker = MapperWorker(config, received.append, lambda: None, fuse_keyframes)
    for n in (0, 2):
        put(ring, n, CONSTRAINT, mount)
    worker.process_frames()
    worker.handle(SaveMapRequest("home"))
    (grid,) = [each for each in received if isinstance(each, OccupancyGrid)]
    assert np.any(grid.cells == OCCUPIED)
    loading = replace(config, map_config=replace(WITH_LOOP_CLOSURE, load="home"), first_frame=2)
    received.clear()
    later = MapperWorker(loading, received.append, lambda: None, fuse_keyframes)
    later.process_frames()
    (again,) = [each for each in received if isinstance(each, OccupancyGrid)]
    assert again.equals(grid)
    (result,) = [each for each in received if isinstance(each, LoadMapResult)]
    assert (result.keyframe_count, result.grid_fault) == (2, "")


def test_a_map_without_a_keyframe_since_it_was_loaded_is_not_saved(
    ring: RecordRingWriter, tmp_path: Path
) -> None:
    home = tmp_path / "home.keyframes"
    write_map(home, make_loop_closer(3).contents)
    received: list[MapperMessage] = []
    config = MapperWorkerConfig(ring.memory, 0, tmp_path, replace(WITH_LOOP_CLOSURE, load="home"))
    worker = MapperWorker(config, received.append, lambda: None, fuse_keyframes)
    worker.handle(SaveMapRequest("other"))
    (result,) = [each for each in received if isinstance(each, SaveMapResult)]
    assert result.error.endswith("other.ply: there is no keyframe yet")
    assert list(tmp_path.iterdir()) == [home]


@pytest.mark.parametrize(("height_m", "text"), [(0.5, "no cells"), (0.0, "")])
def test_a_map_without_cells_is_loaded_and_says_so_if_the_camera_could_have_seen_some(
    ring: RecordRingWriter, tmp_path: Path, height_m: float, text: str
) -> None:
    write_map(tmp_path / "old.keyframes", make_loop_closer(3).contents)
    received: list[MapperMessage] = []
    settings = replace(WITH_LOOP_CLOSURE, load="old")
    config = MapperWorkerConfig(ring.memory, 0, tmp_path, settings, T_base_camera=mounted(height_m))
    MapperWorker(config, received.append, lambda: None, fuse_keyframes)
    (result,) = [each for each in received if isinstance(each, LoadMapResult)]
    assert result.keyframe_count == 3
    assert text in result.grid_fault
    assert bool(text) == bool(result.grid_fault)


@pytest.mark.parametrize(("is_place", "answers"), [(False, 0), (True, 1)])
def test_after_a_reset_no_result_is_in_the_previous_odom(
    ring: RecordRingWriter, is_place: bool, answers: int
) -> None:
    relocalize: list[OdometryUpdate] = []
    loops = AsynchronousLoopClosure(relocalize.append)
    received: list[MapperMessage] = []
    worker = LoopClosureWorker(WITH_LOOP_CLOSURE, received.append)
    shift = rigid_transform(np.eye(3), [0.3, 0.0, 0.0])
    before, after = make_update(0), replace(make_update(1), epoch=1)
    after = replace(after, T_odom_camera=shift @ after.T_odom_camera)
    loops.on_update(before)
    loops.on_update(after)
    loops.query(render_corner(true_pose(2), 2))
    write_frame(ring, replace(before, T_world_camera=before.T_odom_camera), CONSTRAINT)
    if is_place:  # otherwise it was too unsure to be one
        write_frame(ring, replace(after, T_world_camera=after.T_odom_camera), CONSTRAINT)
    write_frame(ring, relocalize[0], RelocalizationQuery())
    take_in(worker, ring)
    worker.answer_query()
    for message in received:
        if isinstance(message, RelocalizationResult):
            loops.handle_message(message)
    found = loops.poll_results()
    assert len(found) == answers
    for result in found:
        assert np.allclose(result.T_world_camera[:3, 3], odometry_pose(2)[:3, 3], atol=0.02)
