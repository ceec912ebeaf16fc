"""Mesh job: a process that builds a mesh, and that can be killed at any time.

It is a fork of the mapper process, so it shares the memory of the keyframes. Its own memory is
released when it ends.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from drivers.core import UserFacingError
from drivers.core.files import MEGABYTE
from drivers.core.process.worker_main import set_oom_score
from vo_service.config_tables import MapConfig
from vo_service.slam.mapper.map_store import MapStore
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.messages import SaveMapResult

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
