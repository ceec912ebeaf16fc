"""``kinect-vo reconstruct``: make a colored mesh from a recording."""

import json
import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from drivers.core import InputError
from drivers.core.files import atomic_write
from drivers.core.geometry import (
    MAX_STAMP_DIFFERENCE_S,
    Trajectory,
    format_trajectory,
    has_match,
    read_trajectory,
)
from drivers.core.trajectory_files import warn_of_speed
from drivers.core.write_errors import create_output_folder
from drivers.playback.camera import RecordingCamera
from drivers.recording.recording import Recording as OpenRecording
from vo_service.cli.kernels import run_warm_up
from vo_service.cli.options import (
    RERUN_TARGETS,
    CameraFile,
    ConfigFile,
    Json,
    Method,
    Recording,
    Timing,
    Topics,
    load_config,
)
from vo_service.cli.reconstruct_tracking import track_recording
from vo_service.cli.recordings import open_requested
from vo_service.cli.request import (
    CommandRequest,
    Option,
    argument,
    config_option,
    flag,
    option,
    option_of,
)
from vo_service.outputs.rerun.preview import PreviewScene, open_previews
from vo_service.reconstruction.reconstructor import (
    PreviewFrame,
    ReconstructionResult,
    Reconstructor,
)
from vo_service.reconstruction.report import ReconstructionReport
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig
from vo_service.reconstruction.warm_up import warm_up_reconstruction
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal

EPILOG = """\
examples:
  kinect-vo reconstruct recordings/desk
  kinect-vo reconstruct recordings/desk recordings/desk/groundtruth.txt --voxel-m 0.005
  kinect-vo reconstruct recordings/desk desk.txt --rerun serve --output maps/desk
  kinect-vo reconstruct recordings/tour --loop-closure

Without TRAJECTORY the odometry runs first, and frames that it does not track well are left out.
--loop-closure optimizes its poses, so that surfaces seen twice coincide, and the odometry
relocalizes after a loss.
OUTPUT receives map.ply (a mesh with colors and normals, in the trajectory's world), top.png,
perspective.png, view.png, reconstruction.json, and trajectory.txt if the odometry ran.
Ctrl-C ends the fusion and writes the surface so far; a second Ctrl-C writes nothing more.
"""
DEFAULTS = TsdfConfig()
TRAJECTORY_FILE = "trajectory.txt"
_log = logging.getLogger(__name__)


def _size_option(name: str, metavar: str, noun: str) -> Option:
    option = option_of(TsdfConfig, name, metavar=metavar, noun=noun)
    return replace(option, description=f"{option.description} (default: %(default)s)")


@dataclass(frozen=True, kw_only=True)
class ReconstructionRequest(CommandRequest):
    """The recording, its poses, and the size of the map."""

    folder: Recording
    topics: Topics = None
    trajectory: Path | None = argument(
        "poses of the optical camera, as in groundtruth.txt (default: the odometry's)",
        "TRAJECTORY",
        default=None,
    )
    config: ConfigFile = None
    method: Method = None
    timing: Timing = None
    loop_closure: bool = flag(
        "enable loop closure and optimize the odometry's poses before the fusion"
    )
    camera_file: CameraFile = None
    output: Path = option(
        "folder for the results (default: %(default)s)", Path("output/reconstruct"), "FOLDER"
    )
    voxel_m: Annotated[float, _size_option("voxel_m", "M", "a length")] = DEFAULTS.voxel_m
    memory_mb: Annotated[int, _size_option("memory_mb", "MB", "a size")] = DEFAULTS.memory_mb
    max_depth_m: Annotated[float, _size_option("max_depth_m", "M", "a length")] = (
        DEFAULTS.max_depth_m
    )
    rerun: Annotated[
        tuple[str, ...],
        config_option(
            "rerun.targets",
            description=f"show the progress in Rerun: {RERUN_TARGETS}; may be given several times",
            metavar="TARGET",
            is_repeated=True,
        ),
    ] = ()
    json: Json = False


def run(request: ReconstructionRequest) -> int:
    """Estimate or read the poses, fuse the frames, and write the results."""
    config = load_config(request.config, request)
    terminal = Terminal()
    # Check before the work, not after it.
    for option_name in ("loop-closure", "method", "timing"):
        if request.trajectory and getattr(request, option_name.replace("-", "_")):
            raise InputError(
                f"{request.trajectory}: --{option_name} works only on the odometry's own poses; "
                "leave one of the two out"
            )
    recording = open_requested(request.folder, config.camera.file, request.topics)
    poses = None if request.trajectory is None else _read_poses(request.trajectory, recording)
    camera = RecordingCamera(request.folder, config.camera.file, topics=request.topics)
    volume = _make_volume(request)
    create_output_folder(request.output)
    with (
        stop_on_signals() as stop,
        open_previews(
            config.rerun.targets, "kinect-vo-reconstruct", _load_scene_class, terminal.write_line
        ) as previews,
    ):
        with stop.without_exceptions():  # the kernels run on this thread
            run_warm_up(warm_up_reconstruction, terminal, stop)
            loop_counts: dict[str, int] = {}
            trajectory_file = request.output / TRAJECTORY_FILE
            if poses is None:
                poses, loop_counts = track_recording(
                    request.folder, camera, config, request.loop_closure, terminal, stop
                )
                atomic_write(trajectory_file, format_trajectory(poses))
            elif request.trajectory and request.trajectory.resolve() != trajectory_file.resolve():
                trajectory_file.unlink(missing_ok=True)  # of an earlier map in this folder
            reconstructor = Reconstructor(volume, poses, previews)
            with camera, terminal.busy("fusing") as busy:
                reconstructor.run(camera, stop.event, busy.progress_callback("frame"))
        with terminal.busy("making the map") as busy:
            with stop.without_exceptions():
                report = _make_report(request.folder, reconstructor, loop_counts, stop)
            report.save(request.output, busy.set_detail)
    ending = " (cut short)" if report.is_interrupted else ""
    terminal.write_line(f"results: {request.output}{ending}")
    print(json.dumps(report.as_json()) if request.json else report.as_table())
    return stop.exit_code


def _load_scene_class() -> type[PreviewScene[PreviewFrame]]:
    from vo_service.reconstruction.rerun_preview import ReconstructionScene  # imports rerun

    return ReconstructionScene


def _make_volume(request: ReconstructionRequest) -> TsdfVolume:
    try:
        return TsdfVolume(TsdfConfig(request.voxel_m, request.memory_mb, request.max_depth_m))
    except MemoryError as error:
        raise InputError(
            f"--memory-mb {request.memory_mb}: this computer does not have it; give less"
        ) from error


def _read_poses(trajectory: Path, recording: OpenRecording) -> Trajectory:
    """Read the poses of a recording; raise InputError if they belong to another one."""
    poses = read_trajectory(trajectory)
    warn_of_speed(trajectory, poses)
    frames_s = recording.frames.stamps_s
    if not has_match(frames_s, poses.stamps_s).any():
        raise InputError(
            f"{trajectory}: has no pose within {1000 * MAX_STAMP_DIFFERENCE_S:.0f} ms of any frame "
            f"of {recording.path} "
            f"(poses {poses.stamps_s[0]:.3f}..{poses.stamps_s[-1]:.3f} s, frames "
            f"{frames_s[0]:.3f}..{frames_s[-1]:.3f} s): give a trajectory of this recording"
        )
    return poses


def _make_report(
    folder: Path, reconstructor: Reconstructor, loop_counts: dict[str, int], stop: StopSignal
) -> ReconstructionReport:
    """Extract the mesh; warn if the memory limit has cut it short.

    Raises:
        InputError: If the mesh is empty.
        KeyboardInterrupt: If the mesh is empty because of a stop request.
    """
    result, mesh, volume = reconstructor.result, reconstructor.finish(), reconstructor.volume
    config = volume.config
    if not len(mesh.triangles):
        stop.check()
        raise InputError(f"{folder}: {_empty_result_reason(result, config.max_depth_m)}")
    if result.full_at_frame:
        _log.warning(
            "the map was full at frame %d of %d: surfaces seen later are left out; give more than "
            "--memory-mb %d, or larger voxels than --voxel-m %g",
            result.full_at_frame, result.frames, config.memory_mb, config.voxel_m,
        )  # fmt: skip
    title = f"{folder.resolve().name}: {result.fused} of {result.frames} frames, from above"
    return ReconstructionReport(title, mesh, result, volume, stop.event.is_set(), loop_counts)


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
