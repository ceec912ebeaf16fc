"""Pipeline of ``kinect-vo reconstruct``: tracking, fusion, mesh, report."""

import argparse
import json
import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.camera import RgbdCamera
from drivers.core import InputError
from drivers.core.files import atomic_write
from drivers.core.geometry import (
    MAX_STAMP_DIFFERENCE_S,
    Trajectory,
    format_pose_line,
    has_match,
    read_trajectory,
)
from drivers.core.write_errors import create_output_folder
from drivers.playback.camera import RecordingCamera
from drivers.recording.recording import Recording
from vo_service.app import run_replay
from vo_service.cli.loop_closure_options import make_loop_closure
from vo_service.cli.options import load_config, prepare_kernels, requested_topics, run_warm_up
from vo_service.cli.recordings import open_requested
from vo_service.config import Config
from vo_service.frame_source import FrameSource
from vo_service.outputs.progress import ProgressOutput
from vo_service.outputs.rerun.preview import PreviewScene, open_previews
from vo_service.reconstruction.reconstructor import (
    FramePoses,
    PreviewFrame,
    ReconstructionResult,
    Reconstructor,
    TrackedPoseRecorder,
)
from vo_service.reconstruction.report import ReconstructionReport
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig
from vo_service.reconstruction.warm_up import warm_up_reconstruction
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal
from vo_service.types.outputs import NullLoopClosure, Output

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.synchronous_loop_closure import SynchronousLoopClosure

_log = logging.getLogger(__name__)


TRAJECTORY_FILE = "trajectory.txt"


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
        config: The configuration.
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
        result = run_replay(
            config, camera, FrameSource(camera), own, stop, loop_closure or NullLoopClosure()
        )
    for output in own:
        output.close()
    stop.check()
    result.check_has_motion(str(folder))
    if loop_closure:
        recorder.apply_correction(
            loop_closure.trajectory, loop_closure.loop_closer.graph.are_connected
        )
    poses = recorder.longest_trajectory
    if recorder.epoch_count > 1:
        _log.warning(
            "tracking restarted %d times after a loss: the map has only the longest part, %d of %d "
            "frames; for all frames give a trajectory",
            recorder.epoch_count - 1, len(poses), recorder.frame_count,
        )  # fmt: skip
    return poses


def run_reconstruction(args: argparse.Namespace) -> int:
    """Estimate or read the poses, fuse the frames, and write the results.

    Raises:
        UserFacingError: If an input is not valid, or if a result cannot be written.
    """
    config = load_config(args)
    camera_file = args.camera_file or config.camera.file
    terminal = Terminal()
    # Check before the work, not after it.
    if args.loop_closure and args.trajectory is not None:
        raise InputError(
            f"{args.trajectory}: --loop-closure works only on the odometry's own poses; "
            "leave one of the two out"
        )
    recording = open_requested(args, camera_file)
    poses = None if args.trajectory is None else _read_trajectory(args.trajectory, recording)
    loop_closure_counts: Mapping[str, int] = {}
    fusion = _make_volume(args)
    create_output_folder(args.output)
    with (
        stop_on_signals() as stop,
        open_previews(
            config.rerun.targets, "kinect-vo-reconstruct", _load_scene_class, terminal.write_line
        ) as views,
    ):
        with stop.without_exceptions():  # the kernels run on this thread
            run_warm_up(warm_up_reconstruction, terminal, stop)
            if poses is None:
                tracked = _make_camera(args, camera_file)
                poses, loop_closure_counts = _track_and_save(args, tracked, config, terminal, stop)
            reconstruction = Reconstructor(fusion, FramePoses(poses), views)
            with _make_camera(args, camera_file) as camera, terminal.busy("fusing") as busy:
                reconstruction.run(camera, stop.event, busy.progress_callback("frame"))
        with terminal.busy("making the map") as busy:
            with stop.without_exceptions():
                results = _make_results(args.folder, reconstruction, fusion, stop)
            results = replace(results, loop_closure_counts=loop_closure_counts)
            results.save(args.output, busy.set_detail)
    terminal.write_line(
        f"results: {args.output}" + (" (cut short)" if results.is_interrupted else "")
    )
    print(json.dumps(results.as_json()) if args.json else results.as_table())
    return stop.exit_code


def _make_camera(args: argparse.Namespace, camera_file: Path | None) -> RecordingCamera:
    return RecordingCamera(args.folder, camera_file, topics=requested_topics(args))


def _load_scene_class() -> type[PreviewScene[PreviewFrame]]:
    from vo_service.reconstruction.rerun_preview import ReconstructionScene  # imports rerun

    return ReconstructionScene


def _make_volume(args: argparse.Namespace) -> TsdfVolume:
    try:
        return TsdfVolume(TsdfConfig(args.voxel_m, args.memory_mb, args.max_depth_m))
    except MemoryError as error:
        raise InputError(
            f"--memory-mb {args.memory_mb}: this computer does not have it; give less"
        ) from error


def _read_trajectory(trajectory: Path, recording: Recording) -> Trajectory:
    """Read the poses of a recording; raise InputError if they belong to another one."""
    poses = read_trajectory(trajectory)
    frames_s = recording.frames.stamps_s
    if not has_match(frames_s, poses.stamps_s).any():
        raise InputError(
            f"{trajectory}: has no pose within {1000 * MAX_STAMP_DIFFERENCE_S:.0f} ms of any frame "
            f"of {recording.path} "
            f"(poses {poses.stamps_s[0]:.3f}..{poses.stamps_s[-1]:.3f} s, frames "
            f"{frames_s[0]:.3f}..{frames_s[-1]:.3f} s): give a trajectory of this recording"
        )
    return poses


def _track_and_save(
    args: argparse.Namespace,
    camera: RecordingCamera,
    config: Config,
    terminal: Terminal,
    stop: StopSignal,
) -> tuple[Trajectory, Mapping[str, int]]:
    """Run the odometry and write its poses; also return counts of loop closure, if enabled."""
    loops = make_loop_closure(config, terminal, stop) if args.loop_closure else None
    poses = track_recording(args.folder, camera, config, terminal, stop, loops)
    lines = map(format_pose_line, poses.stamps_s, poses.T_world_camera)
    atomic_write(args.output / TRAJECTORY_FILE, "".join(lines).encode())
    if loops is None:
        return poses, {}
    return poses, {
        "map_keyframes": len(loops.loop_closer.database),
        "loop_closures": loops.loop_closer.loop_count,
    }


def _make_results(
    folder: Path, reconstruction: Reconstructor, volume: TsdfVolume, stop: StopSignal
) -> ReconstructionReport:
    """Extract the mesh; warn if the memory limit has cut it short.

    Raises:
        InputError: If the mesh is empty.
        KeyboardInterrupt: If the mesh is empty because of a stop request.
    """
    result, mesh = reconstruction.result, reconstruction.finish()
    if result.camera is None or not len(mesh.triangles):
        stop.check()
        raise InputError(f"{folder}: {_empty_result_reason(result, volume.config.max_depth_m)}")
    if result.full_at_frame:
        _log.warning(
            "the map was full at frame %d of %d: surfaces seen later are left out; give more than "
            "--memory-mb %d, or larger voxels than --voxel-m %g",
            result.full_at_frame, result.frames, volume.config.memory_mb, volume.config.voxel_m,
        )  # fmt: skip
    title = f"{folder.resolve().name}: {result.fused} of {result.frames} frames, from above"
    return ReconstructionReport(title, result.camera, mesh, result, volume, stop.event.is_set())


def _empty_result_reason(result: ReconstructionResult, max_depth_m: float) -> str:
    if result.without_depth and not result.fused:
        return (
            f"no depth up to {max_depth_m:g} m in any of {result.without_depth} frames; give a "
            "recording with depth, the right depth_factor, or a greater --max-depth-m"
        )
    return (
        f"{result.fused} of {result.frames} frames were usable, too few for a surface; give more "
        "frames, or larger voxels with --voxel-m"
    )
