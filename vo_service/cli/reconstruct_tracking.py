"""Tracking of a recording for its reconstruction: the longest trajectory in one world."""

import logging
from pathlib import Path

from drivers.core.geometry import Trajectory
from drivers.playback.camera import RecordingCamera
from vo_service.app import run_replay
from vo_service.cli.kernels import prepare_kernels
from vo_service.cli.loop_closure import make_loop_closure
from vo_service.config import Config
from vo_service.frame_source import FrameSource
from vo_service.outputs.progress import ProgressOutput
from vo_service.reconstruction.reconstructor import TrackedPoseRecorder
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal
from vo_service.types.outputs import NullLoopClosure, Output

_log = logging.getLogger(__name__)


def track_recording(
    folder: Path,
    camera: RecordingCamera,
    config: Config,
    with_loop_closure: bool,
    terminal: Terminal,
    stop: StopSignal,
) -> tuple[Trajectory, dict[str, int]]:
    """Run the odometry over a recording.

    Loop closure optimizes the poses, and trajectories that it connects are one. Errors name the
    `folder` of the recording.

    Returns:
        The longest tracked trajectory, with the frames' own stamps; and the counts of loop closure
        by name, {} without it.

    Raises:
        InputError: If no frame was tracked.
        KeyboardInterrupt: If a stop is requested.
    """
    loop_closure = make_loop_closure(config, terminal, stop) if with_loop_closure else None
    prepare_kernels(config, terminal, stop)
    recorder = TrackedPoseRecorder()
    with camera:
        progress = ProgressOutput(terminal, "tracking", camera.frame_count)
        own: list[Output] = [*([loop_closure] if loop_closure else []), recorder, progress]
        result = run_replay(
            config, camera, FrameSource(camera), own, stop, loop_closure or NullLoopClosure()
        )
    for output in own:
        output.close()
    stop.check()
    result.check_has_motion(str(folder))
    counts: dict[str, int] = {}
    if loop_closure:
        graph = loop_closure.loop_closer.graph
        recorder.apply_correction(loop_closure.trajectory, graph.are_connected)
        counts = loop_closure.counts
    poses = recorder.longest_trajectory
    if recorder.epoch_count > 1:
        _log.warning(
            "tracking restarted %d times after a loss: the map has only the longest part, %d of %d "
            "frames; for all frames give a trajectory",
            recorder.epoch_count - 1, len(poses), recorder.frame_count,
        )  # fmt: skip
    return poses, counts
