"""Making a map, in a process of its own: killed at once where it must be, and nothing else with it.

It is a copy of the mapper's process, by `fork`, and so has the keyframes as they were, in the same
memory. What it takes itself goes back to the system when it ends.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
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


# Fuses keyframes into a surface. The mapper is given it: SLAM does not know the reconstruction.
FuseKeyframes = Callable[[Iterable[MeshKeyframe], MapConfig], FusedMesh]


def build_mesh(
    store: MapStore,
    name: str,
    keyframes: Sequence[MeshKeyframe],
    config: MapConfig,
    fuse_keyframes: FuseKeyframes,
) -> SaveMapResult:
    """Fuse the keyframes and write the surface; how it ended."""
    set_oom_score(OOM_SCORE)
    file = store.mesh_file(name)
    try:
        mesh = fuse_keyframes(_throttle(keyframes), config)
        if not mesh.triangle_count:
            return SaveMapResult(file, error=f"{file}: no surface was seen well enough")
        _exit_if_orphaned()
        store.write(file, config.total_mb * MEGABYTE, mesh.write)
    except UserFacingError as error:
        return SaveMapResult(file, error=str(error))
    except MemoryError:
        return SaveMapResult(
            file, error=f"{file}: there is not enough memory; lower map.mesh_memory_mb"
        )
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
