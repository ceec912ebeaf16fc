"""Making a map, in a process of its own: killed at once where it must be, and nothing else with it.

It is a copy of the mapper's process, by `fork`, and so has the keyframes as they were, in the same
memory. What it takes itself goes back to the system when it ends.
"""

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from drivers.core.errors import UserFacingError
from drivers.core.process.background import set_oom_score
from vo_service.config_tables import MEGABYTE, MapConfig
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.messages import SaveMapResult
from vo_service.slam.saved_maps.map_store import MapStore

# Of all processes it is the one that takes most, and that can best be done without.
OOM_SCORE = 1000
JOIN_TIMEOUT_S = 5.0


class MeshJob:
    """One map on its way to its file."""

    def __init__(
        self,
        file: Path,
        build: Callable[[], SaveMapResult],
        close_inherited: Callable[[], None],
    ) -> None:
        """Start. `make` runs in the new process; `forget` there before, to leave our things.

        Raises OSError if the system has no room for another process.
        """
        self._file = file
        context = get_context("fork")
        self._result, theirs = context.Pipe(duplex=False)
        with theirs:
            self._process = context.Process(target=_run_job, args=(theirs, build, close_inherited))
            self._process.start()

    @property
    def result_connection(self) -> "Connection[Any, Any]":
        """Becomes ready when it has ended."""
        return self._result

    def wait_for_result(self) -> SaveMapResult:
        """How; waits for it."""
        try:
            end: SaveMapResult = self._result.recv()
        except EOFError:
            end = SaveMapResult(self._file, error=f"{self._file}: its process was ended; memory?")
        self._release()
        return end

    def kill(self) -> None:
        """End it now."""
        self._process.kill()
        self._release()

    def _release(self) -> None:
        self._process.join(JOIN_TIMEOUT_S)
        self._result.close()


def build_mesh(
    store: MapStore, name: str, keyframes: Sequence[MeshKeyframe], settings: MapConfig
) -> SaveMapResult:
    """Fuse the keyframes and write the surface; how it ended."""
    set_oom_score(OOM_SCORE)
    file = store.mesh_file(name)
    try:
        return _fuse_keyframes(store, name, keyframes, settings)
    except UserFacingError as error:
        return SaveMapResult(file, error=str(error))
    except MemoryError:
        return SaveMapResult(file, error=f"{file}: there is not enough memory; lower map.making_mb")


def _fuse_keyframes(
    store: MapStore, name: str, keyframes: Sequence[MeshKeyframe], settings: MapConfig
) -> SaveMapResult:
    # It compiles kernels: only whoever makes a map needs the memory for that.
    from vo_service.reconstruction.ply import write_ply
    from vo_service.reconstruction.tsdf_config import TsdfConfig
    from vo_service.reconstruction.tsdf_volume import TsdfVolume

    file = store.mesh_file(name)
    fusion = TsdfVolume(TsdfConfig(voxel_m=settings.voxel_m, memory_mb=settings.making_mb))
    for keyframe in keyframes:
        begin_cpu_s = time.process_time()
        depth_m, color_bgr = keyframe.depth_m, keyframe.color_bgr
        if fusion.has_depth_in_range(depth_m):
            fusion.integrate(depth_m, color_bgr, keyframe.camera, keyframe.T_odom_camera)
        _exit_if_orphaned()
        # Half of one processor is enough: the poses need the rest, where `nice` is forbidden too.
        time.sleep(time.process_time() - begin_cpu_s)
    mesh = fusion.extract_mesh()
    if not len(mesh.triangles):
        raise UserFacingError(f"{file}: no surface was seen well enough")
    _exit_if_orphaned()
    store.write(file, settings.total_mb * MEGABYTE, partial(write_ply, mesh=mesh))
    return SaveMapResult(file, len(keyframes), len(mesh.triangles), fusion.is_full)


def _exit_if_orphaned() -> None:
    """End, leaving nothing, where the mapper's process has been killed."""
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
