"""The odometry over a recording, for the poses that a map is made with."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.camera import RgbdCamera
from drivers.errors import InputError
from drivers.trajectory import StampedPoses
from vo_service.app import run_loop
from vo_service.commands.kernels import prepare_kernels
from vo_service.config import Config
from vo_service.feed import PlainFeed
from vo_service.interrupts import Stop
from vo_service.mapping.frame_poses import TrackedPoses
from vo_service.outputs.progress_output import ProgressOutput
from vo_service.terminal import Terminal
from vo_service.types import NoLoops, Output

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.mapping.loops.inline import InlineLoops

_log = logging.getLogger(__name__)


def tracked(
    folder: Path,
    camera: RgbdCamera,
    config: Config,
    terminal: Terminal,
    stop: Stop,
    loops: "InlineLoops | None" = None,
) -> StampedPoses:
    """Poses of the longest stretch that was tracked, under the frames' own stamps.

    With loops, as these have corrected them in the end; what they join is one stretch.
    Raises InputError if there is none, KeyboardInterrupt when asked to stop.
    """
    prepare_kernels(config, terminal, stop)
    memory = TrackedPoses()
    with camera:
        progress = ProgressOutput(terminal, "tracking", camera.frame_count)
        own: list[Output] = [*([loops] if loops else []), memory, progress]
        run_loop(config, camera, PlainFeed(camera), own, stop, loops or NoLoops())
    for output in own:
        output.close()
    stop.check()
    if loops:
        memory.correct(loops.trajectory, loops.closer.graph.is_joined)
    poses = memory.longest
    if not len(poses):
        raise InputError(
            f"{folder}: the odometry found no motion in any of {memory.frames} frames: see "
            "`kinect-vo replay`, or give a trajectory"
        )
    if memory.epochs > 1:
        _log.warning(
            "tracking was lost for good %d times: the map has the longest stretch, %d of %d "
            "frames; for all of them give a trajectory that knows how the others lie to it",
            memory.epochs - 1, len(poses), memory.frames,
        )  # fmt: skip
    return poses
