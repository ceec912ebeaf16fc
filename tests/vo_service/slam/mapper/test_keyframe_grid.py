"""The occupancy grid of the mapper: sent on change, with a rate limit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform
from drivers.core.process.record_ring import RecordRingWriter
from tests.vo_service.navigation.views import mounted, wall_on_floor
from vo_service.config_tables import MapConfig
from vo_service.slam.mapper import keyframe_grid as module
from vo_service.slam.mapper.keyframe_grid import KeyframeGrid
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.messages import MapperMessage, MapperWorkerConfig
from vo_service.slam.pose_graph import AnchoredPose
from vo_service.types.occupancy_grid import OccupancyGrid

MOUNT = mounted(0.5, 10.0)


class Clock:
    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def at(grid: KeyframeGrid, x_m: float) -> MeshKeyframe:
    """A keyframe with a wall 2 m ahead."""
    T = rigid_transform(np.eye(3), (x_m, 0.0, 0.0)) @ MOUNT
    frame = wall_on_floor(MOUNT, 2.0)
    cells = grid.mapper.cells(frame, T)
    pose = AnchoredPose(None, T)
    return MeshKeyframe(0, T, frame.camera, 5000.0, b"", b"", pose, cells)


def unchanged(pose: AnchoredPose) -> Array:
    return pose.T_keyframe_camera


def test_a_grid_is_sent_when_it_has_changed_at_most_so_often(clock: Clock, tmp_path: Path) -> None:
    sent: list[MapperMessage] = []
    ring = RecordRingWriter("trial", 5.0, 1 << 16)
    config = MapperWorkerConfig(ring.memory, 0, tmp_path, MapConfig(publish_hz=2.0))
    grid = KeyframeGrid(replace(config, T_base_camera=MOUNT), sent.append)
    keyframes = [at(grid, 0.0)]
    grid.send_if_due(keyframes, unchanged)
    assert not sent  # nothing was marked
    grid.mark_stale()
    grid.send_if_due(keyframes, unchanged)
    assert len(sent) == 1
    keyframes.append(at(grid, 0.5))
    grid.mark_stale()
    grid.send_if_due(keyframes, unchanged)
    assert len(sent) == 1  # too early
    clock.now_s += 0.6
    grid.send_if_due(keyframes, unchanged)
    assert len(sent) == 2
    clock.now_s += 0.6
    grid.mark_stale()
    grid.send_if_due(keyframes, unchanged)
    assert len(sent) == 2  # the same cells
    shift = rigid_transform(np.eye(3), (0.0, 3.0, 0.0))
    clock.now_s += 0.6
    grid.mark_stale()
    grid.send_if_due(keyframes, lambda pose: shift @ pose.T_keyframe_camera)
    first, moved = sent[1], sent[2]
    assert isinstance(first, OccupancyGrid)
    assert isinstance(moved, OccupancyGrid)
    assert moved.origin_xy_m[1] == pytest.approx(first.origin_xy_m[1] + 3.0)
    np.testing.assert_array_equal(moved.cells, first.cells)
    ring.close()
