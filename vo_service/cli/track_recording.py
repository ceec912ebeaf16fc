"""Tracking of a recording, for the poses of a reconstruction."""

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
    """Run the odometry over a recording and return the longest tracked trajectory.

    Args:
        folder: Folder of the recording, for error messages.
        camera: The recording.
        config: The configuration.
        terminal: Shows progress.
        stop: Stop request.
        loop_closure: If given, the poses are optimized, and trajectories that it connects are one.

    Returns:
        The trajectory, with the frames' own stamps.

    Raises:
        InputError: If no frame was tracked.
        KeyboardInterrupt: If a stop is requested.
    """
    prepare_kernels(config, terminal, stop)
    recorder = TrackedPoseRecorder()
    with camera:
        progress = ProgressOutput(terminal, "tracking", camera.frame_count)
        own: list[Output] = [*([loop_closure] if loop_closure else []), recorder, progress]
        run_replay(
            config, camera, SinglePassSource(camera), own, stop, loop_closure or NullLoopClosure()
        )
    for output in own:
        output.close()
    stop.check()
    if loop_closure:
        recorder.apply_correction(
            loop_closure.trajectory, loop_closure.loop_closer.graph.are_connected
        )
    poses = recorder.longest_trajectory
    if not len(poses):
        raise InputError(
            f"{folder}: the odometry found no motion in any of {recorder.frame_count} frames: see "
            "`kinect-vo replay`, or give a trajectory"
        )
    if recorder.epoch_count > 1:
        _log.warning(
            "tracking restarted %d times after a loss: the map has only the longest part, %d of %d "
            "frames; for all frames give a trajectory",
            recorder.epoch_count - 1, len(poses), recorder.frame_count,
        )  # fmt: skip
    return poses
