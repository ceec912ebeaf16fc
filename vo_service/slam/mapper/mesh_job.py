"""Mesh job: a process that builds a mesh, and that can be killed at any time.

It is a fork of the mapper process, so it shares the memory of the keyframes. Its own memory is
released when it ends.
"""

import math
import os
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core import UserFacingError
from drivers.core.files import MEGABYTE
from drivers.core.geometry import Array
from drivers.core.process import RingRecord
from drivers.core.process.worker_main import set_oom_score
from vo_service.config_tables import MapConfig
from vo_service.frame_record import decode_frame, decode_metadata, unpack_depth
from vo_service.slam import SaveMapResult, pose_distance_steps
from vo_service.slam.mapper.map_store import MapStore
from vo_service.slam.pose_graph import AnchoredPose

if TYPE_CHECKING:
    from vo_service.slam.pose_graph import NodeRemoval

JPEG_QUALITY = 90
# Factor of the spacing after each thinning.
_SPACING_GROWTH = math.sqrt(2.0)


@dataclass(frozen=True)
class MeshKeyframe:
    """A view with color as JPEG, lossless depth and its pose.

    Attributes:
        epoch: Of the pose.
        T_odom_camera: 4x4.
        camera: Intrinsics.
        depth_factor: Depth value per meter.
        jpeg: Color image.
        packed_depth: Depth image.
        anchored_pose: The pose relative to a keyframe of the map, which moves with the map.
    """

    epoch: int
    T_odom_camera: Array
    camera: PinholeCamera
    depth_factor: float
    jpeg: bytes
    packed_depth: bytes
    anchored_pose: AnchoredPose

    @classmethod
    def from_record(cls, record: RingRecord, anchored_pose: AnchoredPose) -> Self:
        """Make a keyframe of a frame in the ring, whose world frame is `odom`."""
        metadata = decode_metadata(record.metadata)
        color_bgr = decode_frame(record, 0.0).color_bgr
        options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        return cls(
            epoch=metadata.published.epoch,
            T_odom_camera=metadata.published.T_world_camera,
            camera=metadata.camera,
            depth_factor=metadata.depth_factor,
            jpeg=cv2.imencode(".jpg", color_bgr, options)[1].tobytes(),
            packed_depth=zlib.compress(record.payload[: metadata.depth_bytes], level=1),
            anchored_pose=anchored_pose,
        )

    @property
    def size_bytes(self) -> int:
        """Bytes of both images."""
        return len(self.jpeg) + len(self.packed_depth)

    @property
    def color_bgr(self) -> NDArray[np.uint8]:
        """(height, width, 3) uint8, with the loss of JPEG."""
        data = np.frombuffer(self.jpeg, np.uint8)
        color: NDArray[np.uint8] = cv2.imdecode(data, cv2.IMREAD_COLOR)  # type: ignore[assignment]
        return color

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 meters, 0 = no reading; lossless."""
        packed = zlib.decompress(self.packed_depth)
        depth_raw = unpack_depth(packed, self.camera.height, self.camera.width)
        return depth_raw * np.float32(1.0 / self.depth_factor)


class MeshKeyframeStore:
    """Mesh keyframes of one epoch in chronological order, with a minimum spacing.

    Args:
        max_bytes: Largest size.
    """

    def __init__(self, max_bytes: int) -> None:
        self.spacing_steps = 1.0
        self.size_bytes = 0
        self._max_bytes = max_bytes
        self._keyframes: list[MeshKeyframe] = []

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[MeshKeyframe]:
        return iter(self._keyframes)

    @property
    def epoch(self) -> int | None:
        """Epoch of the keyframes; None if there are none."""
        return self._keyframes[-1].epoch if self._keyframes else None

    def accepts(self, epoch: int, T_odom_camera: Array) -> bool:
        """Whether a view at a pose would be stored; to be called before it is compressed."""
        return epoch != self.epoch or self._is_far_from_all(T_odom_camera)

    def add(self, keyframe: MeshKeyframe) -> None:
        """Add a keyframe unless one is near; the first one of an epoch removes all others."""
        if keyframe.epoch != self.epoch:
            self.clear()
        if self._is_far_from_all(keyframe.T_odom_camera):
            self._append(keyframe)
            self.set_max_bytes(self._max_bytes)

    def re_anchor(self, removal: "NodeRemoval") -> None:
        """Re-anchor the poses after the removal of a map keyframe."""
        self._keyframes = [
            replace(each, anchored_pose=each.anchored_pose.re_anchor(removal))
            for each in self._keyframes
        ]

    def clear(self) -> None:
        """Remove all keyframes."""
        self._keyframes, self.size_bytes, self.spacing_steps = [], 0, 1.0

    def set_max_bytes(self, max_bytes: int) -> None:
        """Set the largest size; the spacing grows if it is exceeded. The first keyframe stays."""
        self._max_bytes = max_bytes
        while self.size_bytes > max_bytes and len(self._keyframes) > 1:
            self.spacing_steps *= _SPACING_GROWTH
            before, self._keyframes, self.size_bytes = self._keyframes, [], 0
            for keyframe in before:
                if self._is_far_from_all(keyframe.T_odom_camera):
                    self._append(keyframe)

    def _append(self, keyframe: MeshKeyframe) -> None:
        self._keyframes.append(keyframe)
        self.size_bytes += keyframe.size_bytes

    def _is_far_from_all(self, T_odom_camera: Array) -> bool:
        """Whether no keyframe is near a pose."""
        if not self._keyframes:
            return True
        others = np.array([each.T_odom_camera for each in self._keyframes])
        return bool(pose_distance_steps(T_odom_camera, others).min() >= self.spacing_steps)


# The process uses the most memory and is the least important one.
OOM_SCORE = 1000
JOIN_TIMEOUT_S = 5.0


class MeshJob:
    """A running process that builds a mesh.

    Args:
        file: Path of the mesh.
        build: Runs in the new process.
        close_inherited: Called there before, to close inherited connections.

    Raises:
        OSError: The process cannot be started.
    """

    def __init__(
        self,
        file: Path,
        build: Callable[[], SaveMapResult],
        close_inherited: Callable[[], None],
    ) -> None:
        self._file = file
        context = get_context("fork")
        self._result, sender = context.Pipe(duplex=False)
        with sender:
            self._process = context.Process(target=_run_job, args=(sender, build, close_inherited))
            self._process.start()

    @property
    def result_connection(self) -> "Connection[Any, Any]":
        """Connection that is ready when the process has ended."""
        return self._result

    def wait_for_result(self) -> SaveMapResult:
        """Wait for the result."""
        try:
            result: SaveMapResult = self._result.recv()
        except EOFError:
            result = SaveMapResult(
                self._file,
                error=f"{self._file}: the mesh process was killed, perhaps as memory was low",
            )
        self._release()
        return result

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._release()

    def _release(self) -> None:
        self._process.join(JOIN_TIMEOUT_S)
        self._result.close()


@dataclass(frozen=True)
class FusedMesh:
    """A surface that was made of keyframes.

    Attributes:
        triangle_count: How many triangles it has.
        is_full: Whether its memory was full, so that a part is missing.
        write: Writes it into a file.
    """

    triangle_count: int
    is_full: bool
    write: Callable[[Path], None]


# Fuses keyframes into a mesh. It is passed to the mapper: SLAM does not import the reconstruction.
FuseKeyframes = Callable[[Iterable[MeshKeyframe], MapConfig], FusedMesh]


def build_mesh(
    store: MapStore,
    name: str,
    keyframes: Sequence[MeshKeyframe],
    config: MapConfig,
    fuse_keyframes: FuseKeyframes,
) -> SaveMapResult:
    """Fuse the keyframes and write the mesh."""
    set_oom_score(OOM_SCORE)
    file = store.mesh_file(name)
    try:
        mesh = fuse_keyframes(_throttle(keyframes), config)
        if not mesh.triangle_count:
            return SaveMapResult(file, error=f"{file}: no surface was observed well enough")
        _exit_if_orphaned()
        store.write(file, config.total_mb * MEGABYTE, mesh.write)
    except UserFacingError as error:
        return SaveMapResult(file, error=str(error))
    except MemoryError:
        return SaveMapResult(file, error=f"{file}: not enough memory; decrease map.mesh_memory_mb")
    return SaveMapResult(file, len(keyframes), mesh.triangle_count, mesh.is_full)


def _throttle(keyframes: Iterable[MeshKeyframe]) -> Iterator[MeshKeyframe]:
    """Yield keyframes, resting after each for as long as its work took.

    Half of one processor is enough: the poses need the rest, where `nice` is forbidden too.
    """
    for keyframe in keyframes:
        begin_cpu_s = time.process_time()
        yield keyframe
        _exit_if_orphaned()
        time.sleep(time.process_time() - begin_cpu_s)


def _exit_if_orphaned() -> None:
    """Exit at once if the mapper process has been killed."""
    mapper = parent_process()
    if mapper is None or not mapper.is_alive():
        os._exit(1)


def _run_job(
    result: "Connection[Any, Any]",
    build: Callable[[], SaveMapResult],
    close_inherited: Callable[[], None],
) -> None:
    close_inherited()
    result.send(build())
