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

from drivers.errors import UserFacingError
from vo_service.background.child import be_ended_first
from vo_service.mapping.live.keyframes import Keyframe
from vo_service.mapping.live.maps_folder import MapsFolder
from vo_service.mapping.live.messages import MapEnded
from vo_service.settings import MEGABYTE, MapSettings

# Of all processes it is the one that takes most, and that can best be done without.
OOM_SCORE = 1000
REAPED_S = 5.0


class Making:
    """One map on its way to its file."""

    def __init__(
        self,
        file: Path,
        make: Callable[[], MapEnded],
        forget: Callable[[], None],
    ) -> None:
        """Start. `make` runs in the new process; `forget` there before, to leave our things.

        Raises OSError if the system has no room for another process.
        """
        self._file = file
        context = get_context("fork")
        self._result, theirs = context.Pipe(duplex=False)
        with theirs:
            self._process = context.Process(target=_run, args=(theirs, make, forget))
            self._process.start()

    @property
    def source(self) -> "Connection[Any, Any]":
        """Becomes ready when it has ended."""
        return self._result

    def ended(self) -> MapEnded:
        """How; waits for it."""
        try:
            end: MapEnded = self._result.recv()
        except EOFError:
            end = MapEnded(self._file, trouble=f"{self._file}: its process was ended; memory?")
        self._release()
        return end

    def give_up(self) -> None:
        """End it now."""
        self._process.kill()
        self._release()

    def _release(self) -> None:
        self._process.join(REAPED_S)
        self._result.close()


def make_map(
    folder: MapsFolder, name: str, keyframes: Sequence[Keyframe], settings: MapSettings
) -> MapEnded:
    """Fuse the keyframes and write the surface; how it ended."""
    be_ended_first(OOM_SCORE)
    file = folder.file(name)
    try:
        return _made(folder, name, keyframes, settings)
    except UserFacingError as error:
        return MapEnded(file, trouble=str(error))
    except MemoryError:
        return MapEnded(file, trouble=f"{file}: there is not enough memory; lower map.making_mb")


def _made(
    folder: MapsFolder, name: str, keyframes: Sequence[Keyframe], settings: MapSettings
) -> MapEnded:
    # It compiles kernels: only whoever makes a map needs the memory for that.
    from vo_service.mapping.fusion import Fusion
    from vo_service.mapping.fusion_settings import FusionSettings
    from vo_service.mapping.ply import write_ply

    file = folder.file(name)
    fusion = Fusion(FusionSettings(voxel_m=settings.voxel_m, memory_mb=settings.making_mb))
    for keyframe in keyframes:
        begin_cpu_s = time.process_time()
        depth_m, colour_bgr = keyframe.depth_m, keyframe.colour_bgr
        if fusion.has_depth(depth_m):
            fusion.add(depth_m, colour_bgr, keyframe.camera, keyframe.T_odom_camera)
        _check_is_wanted()
        # Half of one processor is enough: the poses need the rest, where `nice` is forbidden too.
        time.sleep(time.process_time() - begin_cpu_s)
    mesh = fusion.mesh()
    if not len(mesh.triangles):
        raise UserFacingError(f"{file}: no surface was seen well enough")
    _check_is_wanted()
    folder.write(file, settings.total_mb * MEGABYTE, partial(write_ply, mesh=mesh))
    return MapEnded(file, len(keyframes), len(mesh.triangles), fusion.is_full)


def _check_is_wanted() -> None:
    """End, leaving nothing, where the mapper's process has been killed."""
    mapper = parent_process()
    if mapper is None or not mapper.is_alive():
        os._exit(1)


def _run(
    result: "Connection[Any, Any]", make: Callable[[], MapEnded], forget: Callable[[], None]
) -> None:
    forget()
    result.send(make())
