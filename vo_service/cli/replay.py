"""``kinect-vo replay``: run the odometry over a recording and print a summary."""

import json
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from drivers.camera import PlaybackMode
from drivers.core import InputError
from drivers.core.files import atomic_write
from drivers.core.geometry import format_trajectory
from drivers.core.write_errors import check_output_file
from drivers.playback.camera import RecordingCamera
from vo_service.app import (
    OutputsConfig,
    check_files_differ,
    make_wheel_odometry,
    open_frames,
    open_outputs,
    open_scans,
    run_replay,
)
from vo_service.cli.kernels import prepare_kernels
from vo_service.cli.loop_closure import make_loop_closure
from vo_service.cli.options import (
    CameraFile,
    ConfigFile,
    Json,
    McapFile,
    Method,
    NoPublish,
    Profile,
    Recording,
    RerunTargets,
    Timing,
    Topics,
    TrajectoryFile,
    at_pace,
    load_config,
    parse_playback_mode,
    parse_seconds,
)
from vo_service.cli.request import CommandRequest, flag, option
from vo_service.config import Config
from vo_service.config_tables import RerunConfig
from vo_service.frame_source import FrameSource
from vo_service.outputs.progress import ProgressOutput
from vo_service.outputs.trajectory.trajectory_file import TrajectoryRecorder
from vo_service.outputs.zenoh.free_port import ConnectOnFreePort
from vo_service.outputs.zenoh.output import ConnectOnce
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal, announce_if_slow
from vo_service.tools.evaluation.run_summary import (
    LoopClosureSummary,
    RunSummary,
    evaluate_if_possible,
)
from vo_service.types.outputs import NullLoopClosure, Output
from vo_service.wheel_odometry.wheel_odometry import WheelOdometrySource

EPILOG = """\
examples:
  kinect-vo replay recordings/desk --trajectory desk.txt
  kinect-vo replay recordings/desk --pace realtime --rerun serve
  kinect-vo replay desk.bag --topics /camera/rgb/image_color /camera/depth/image
  kinect-vo replay recordings/desk --json --no-publish | jq .ate_rmse_m
  kinect-vo replay recordings/desk --mcap desk-with-poses.mcap
  kinect-vo replay recordings/tour --optimized-trajectory tour.txt

A folder needs FOLDER/camera.toml, a name that contains freiburg1, freiburg2 or freiburg3, or
--camera-file FILE. A bag has its camera_info. Folders of other benchmarks (ICL-NUIM, 7-Scenes,
Redwood, ScanNet, Bonn, CoRBS) are recognized, and a line says what was assumed. With true poses in
the folder or the bag, the summary contains the errors of the trajectory. docs/guide/bags.md and
docs/guide/recording.md describe the formats.

lockstep runs every frame as fast as possible and repeats bit for bit; subscribers get every pose.
realtime keeps the recording's own clock and drops late frames, as on the robot.

Several replays can run at once, and beside the service: if the default port is taken, poses are
published on a free one, which is printed. If a configured port (zenoh.listen) is taken, or any port
with --wait-for-subscriber, the command ends with an error.

--loop-closure recognizes places that were seen before. It relocalizes the camera after a loss, and
the summary shows the gain. Published poses stay smooth; the optimized trajectory is written to the
file of --optimized-trajectory.
"""

# Files of a recording besides its images, in any layout.
RECORDING_FILES = (
    "rgb.txt", "depth.txt", "associations.txt", "camera.toml", "frame-*", "*info.txt",
    "groundtruth.*", "*trajectory.log", "*-traj.txt", "*.gt.freiburg", "pose/*", "intrinsic/*",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ReplayRequest(CommandRequest):
    """The recording, the odometry, and what becomes of its results."""

    folder: Recording
    topics: Topics = None
    config: ConfigFile = None
    method: Method = None
    timing: Timing = None
    profile: Profile = None
    pace: PlaybackMode = option(
        "lockstep (default) or realtime", PlaybackMode.LOCKSTEP, "PACE", parse_playback_mode
    )
    camera_file: CameraFile = None
    trajectory: TrajectoryFile = None
    mcap: McapFile = None
    rerun: RerunTargets = ()
    no_publish: NoPublish = False
    loop_closure: bool = flag("enable loop closure and optimize the trajectory")
    optimized_trajectory: Path | None = option(
        "write the trajectory as optimized by loop closure; implies --loop-closure", metavar="FILE"
    )
    wait_for_subscriber: float = option(
        "start when a subscriber connects, or after SECONDS", 0.0, "SECONDS", parse_seconds
    )
    json: Json = False


def run(request: ReplayRequest) -> int:
    """Replay and print the summary."""
    if request.no_publish and request.wait_for_subscriber:
        raise InputError(
            "--wait-for-subscriber: nobody can subscribe with --no-publish; leave one of them out"
        )
    config = at_pace(load_config(request.config, request), request.pace)
    _check_not_overwriting(request, config.rerun)
    if request.optimized_trajectory is not None:
        check_output_file(request.optimized_trajectory)
    terminal = Terminal()
    recorder = TrajectoryRecorder()
    camera = RecordingCamera(
        request.folder, config.camera.file, request.pace, topics=request.topics
    )
    with closing(camera):
        with announce_if_slow(f"reading {request.folder}"):
            camera.open()
        with stop_on_signals() as stop:
            prepare_kernels(config, terminal, stop)
            closes_loops = request.loop_closure or request.optimized_trajectory is not None
            loop_closure = make_loop_closure(config, terminal, stop) if closes_loops else None
        wheel_odometry = make_wheel_odometry(config, camera)
        outputs_config = _make_outputs_config(request, config, camera, wheel_odometry, terminal)
        progress = ProgressOutput(terminal, "replay", camera.frame_count)
        own: list[Output] = [recorder, *([loop_closure] if loop_closure else []), progress]
        with open_outputs(outputs_config) as opened, stop_on_signals() as stop:
            result = run_replay(
                config,
                camera,
                FrameSource(camera),
                [*opened.outputs, *own],
                stop,
                loop_closure or NullLoopClosure(),
                wheel_odometry,
                open_scans(config, outputs_config),
            )
        for output in own:
            output.close()
        truth = camera.ground_truth
        frames_s = camera.recording.frames.stamps_s
        evaluation = evaluate_if_possible(recorder.trajectory, truth, frames_s)
        summary = RunSummary(result.statistics, camera.counters, evaluation)
        if loop_closure:
            optimized = evaluate_if_possible(loop_closure.trajectory, truth, frames_s)
            loops = LoopClosureSummary(**loop_closure.counts, evaluation=optimized)
            summary = replace(summary, loop_closure=loops)
    if loop_closure and request.optimized_trajectory:
        text = format_trajectory(loop_closure.trajectory, recorder.publish_offset_s)
        atomic_write(request.optimized_trajectory, text)
    print(json.dumps(summary.as_json()) if request.json else summary.as_table())
    result.check_has_motion(str(request.folder))
    return result.exit_code


def _make_outputs_config(
    request: ReplayRequest,
    config: Config,
    camera: RecordingCamera,
    wheel_odometry: WheelOdometrySource,
    terminal: Terminal,
) -> OutputsConfig:
    """Return what becomes of the results."""
    return OutputsConfig(
        playback_mode=request.pace,
        zenoh=None if request.no_publish else config.zenoh,
        extra_endpoints=ExtraEndpoints(frame_ids=config.ros2),
        frames=partial(open_frames, config),
        T_base_camera=config.T_base_camera.T_base_camera,
        # An expected subscriber connects to the configured port.
        connect_policy=ConnectOnce if request.wait_for_subscriber else ConnectOnFreePort,
        wait_for_subscriber_s=request.wait_for_subscriber,
        rerun=config.rerun,
        extra=config.outputs.extra,
        mcap=request.mcap,
        trajectory=request.trajectory,
        ground_truth=lambda: camera.ground_truth,
        wheel_messages=wheel_odometry.open_journal().take,
        log_line=terminal.write_line,
    )


def _check_not_overwriting(request: ReplayRequest, rerun: RerunConfig) -> None:
    """Raise InputError if an output would be written over the recording or another output."""
    outputs = request.trajectory, request.optimized_trajectory, request.mcap
    check_files_differ(rerun, *outputs)
    for path in outputs:
        if path is not None and path.exists():
            recording = request.folder.resolve()
            is_listed = any(path.resolve().match(pattern) for pattern in RECORDING_FILES)
            inside = path.resolve().is_relative_to(recording) and is_listed
            if inside or path.resolve() == recording:
                raise InputError(f"{path}: belongs to the recording; name another file")
