"""The odometry over a recording, for the poses that a map is made with."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.camera import RgbdCamera
from drivers.core.errors import InputError
from drivers.core.trajectory import Trajectory
from vo_service.app import run_replay
from vo_service.cli.kernels import prepare_kernels
from vo_service.config import Config
from vo_service.frame_source import SinglePassSource
from vo_service.outputs.state_log import ProgressOutput
from vo_service.reconstruction.frame_poses import TrackedPoseRecorder
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal
from vo_service.types import NullLoopClosure, Output

_log = logging.getLogger(__name__)

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.loop_closure.synchronous_loop_closure import SynchronousLoopClosure


def track_recording(
    folder: Path,
    camera: RgbdCamera,
    config: Config,
    terminal: Terminal,
    stop: StopSignal,
    loop_closure: "SynchronousLoopClosure | None" = None,
) -> Trajectory:
    """Poses of the longest stretch that was tracked, under the frames' own stamps.

    With loops, as these have corrected them in the end; what they join is one stretch.
    Raises InputError if there is none, KeyboardInterrupt when asked to stop.
    """
    prepare_kernels(config, terminal, stop)
    memory = TrackedPoseRecorder()
    with camera:
        progress = ProgressOutput(terminal, "tracking", camera.frame_count)
        own: list[Output] = [*([loop_closure] if loop_closure else []), memory, progress]
        run_replay(
            config, camera, SinglePassSource(camera), own, stop, loop_closure or NullLoopClosure()
        )
    for output in own:
        output.close()
    stop.check()
    if loop_closure:
        memory.apply_correction(
            loop_closure.trajectory, loop_closure.loop_closer.graph.are_connected
        )
    poses = memory.longest_trajectory
    if not len(poses):
        raise InputError(
            f"{folder}: the odometry found no motion in any of {memory.frame_count} frames: see "
            "`kinect-vo replay`, or give a trajectory"
        )
    if memory.epoch_count > 1:
        _log.warning(
            "tracking was lost for good %d times: the map has the longest stretch, %d of %d "
            "frames; for all of them give a trajectory that knows how the others lie to it",
            memory.epoch_count - 1, len(poses), memory.frame_count,
        )  # fmt: skip
    return poses
