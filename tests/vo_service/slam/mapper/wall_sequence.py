"""A camera that moves along a wall at 2 m, with a mapper and its maps."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import T_BODY_CAMERA, inverse, rigid_transform
from tests.resource_leaks import child_pids
from tests.vo_service.outputs.recorder import recorder_inputs
from tests.waiting import wait_until
from vo_service.config_tables import MapConfig
from vo_service.slam.mapper.client import LiveMapper
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

CAMERA = PinholeCamera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
WALL_M = 2.0
COARSE = MapConfig(loop_closure=False, max_mb=10, voxel_m=0.05, mesh_memory_mb=50)


def make_wall_update(
    seq: int, x_m: float = 0.0, *, epoch: int = 0, state: TrackingState = TrackingState.TRACKING
) -> OdometryUpdate:
    """The wall, seen `x_m` to the right of the start."""
    T_world_camera = rigid_transform(np.eye(3), [x_m, 0.0, 0.0])
    frame = RgbdFrame(
        seq=seq,
        stamp_s=100.0 + seq / 30,
        receive_time_s=0.0,
        color_bgr=np.full((CAMERA.height, CAMERA.width, 3), (40, 80, 160), np.uint8),
        depth_raw=np.full((CAMERA.height, CAMERA.width), int(1000 * WALL_M), np.uint16),
        depth_factor=1000.0,
        camera=CAMERA,
    )
    return replace(
        recorder_inputs.make_update(seq, state),
        epoch=epoch,
        T_world_camera=T_world_camera,
        T_odom_base=T_BODY_CAMERA @ T_world_camera @ inverse(T_BODY_CAMERA),
        T_odom_camera=T_BODY_CAMERA @ T_world_camera,
        frame=frame,
    )


@contextmanager
def running_mapper(folder: Path, settings: MapConfig = COARSE) -> Iterator[LiveMapper]:
    """A ready mapper with a folder of maps; closed at the end."""
    opened = LiveMapper(settings, folder)
    try:
        wait_until(lambda: opened.is_ready, "the mapper's process")
        yield opened
    finally:
        opened.close()


def move_along_wall(mapper: LiveMapper, steps: int, *, epoch: int = 0) -> None:
    """Move along the wall, so that each frame is a keyframe."""
    for seq in range(steps):
        mapper.on_update(make_wall_update(seq, 0.2 * seq, epoch=epoch))
        wait_until(partial(_has_keyframes, mapper, seq + 1), f"keyframe {seq}")


def _has_keyframes(mapper: LiveMapper, keyframes: int) -> bool:
    return mapper.state.mesh_keyframes == keyframes


def save_map(mapper: LiveMapper, name: str) -> Path:
    """Save a map, wait for it, and return its file."""
    file = mapper.save(name).saving
    wait_until(lambda: not mapper.state.saving, f"{file}")
    assert mapper.state.saved == file, mapper.warning
    return Path(file)


def mapper_pid() -> int:
    """Process number of the mapper that was started last."""
    return max(child_pids(), key=_start_ticks)


def _start_ticks(process: int) -> int:
    """On the kernel's clock."""
    return int(Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[19])
