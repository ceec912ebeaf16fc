"""``kinect-vo replay``: run the odometry over a recording and print a summary."""

import argparse
import json
from functools import partial
from pathlib import Path

from drivers.camera import PlaybackMode
from drivers.core import InputError
from vo_service.app import OutputsConfig, open_frames, open_outputs, run_replay
from vo_service.cli.loop_closure_options import (
    add_loop_closure_options,
    check_optimized_trajectory_path,
    make_requested_loop_closure,
    summarize_loop_closure,
    write_optimized_trajectory,
)
from vo_service.cli.options import (
    add_camera_file_option,
    add_config_options,
    add_output_options,
    add_topics_option,
    load_config,
    parse_playback_mode,
    parse_seconds,
    prepare_kernels,
)
from vo_service.cli.recordings import RECORDING_HELP, replayed_recording
from vo_service.frame_source import FrameSource
from vo_service.outputs.progress import ProgressOutput
from vo_service.outputs.trajectory.trajectory_file import TrajectoryRecorder
from vo_service.outputs.zenoh.free_port import ConnectOnFreePort
from vo_service.outputs.zenoh.output import ConnectOnce
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.evaluation.run_summary import RunSummary
from vo_service.types.outputs import NullLoopClosure, Output

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("folder", metavar="RECORDING", type=Path, help=RECORDING_HELP)
    add_topics_option(parser)
    add_config_options(parser)
    parser.add_argument(
        "--pace", type=parse_playback_mode, metavar="PACE", default=PlaybackMode.LOCKSTEP,
        help="lockstep (default) or realtime",
    )  # fmt: skip
    add_camera_file_option(parser)
    add_output_options(parser)
    add_loop_closure_options(parser)
    parser.add_argument(
        "--wait-for-subscriber", metavar="SECONDS", type=parse_seconds, default=0.0,
        help="start when a subscriber connects, or after SECONDS",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")


def run(args: argparse.Namespace) -> int:
    """Replay and print the summary.

    Raises:
        UserFacingError: If an option or the recording is not valid, if an output fails, or if no
            frame has a pose.
    """
    config = load_config(args)
    _check_not_overwriting_recording(args)
    check_optimized_trajectory_path(args)
    terminal = Terminal()
    recorder = TrajectoryRecorder()
    with replayed_recording(args, args.camera_file or config.camera.file, args.pace) as camera:
        with stop_on_signals() as stop:
            prepare_kernels(config, terminal, stop)
            loop_closure = make_requested_loop_closure(args, config, terminal, stop)
        request = OutputsConfig(
            playback_mode=args.pace,
            zenoh=None if args.no_publish else config.zenoh,
            frames=partial(open_frames, config),
            # An expected subscriber connects to the configured port.
            connect_policy=ConnectOnce if args.wait_for_subscriber else ConnectOnFreePort,
            wait_for_subscriber_s=args.wait_for_subscriber,
            rerun=config.rerun,
            extra=config.outputs.extra,
            mcap=args.mcap,
            trajectory=args.trajectory,
            ground_truth=lambda: camera.ground_truth,
            log_line=terminal.write_line,
        )
        progress = ProgressOutput(terminal, "replay", camera.frame_count)
        own: list[Output] = [recorder, *([loop_closure] if loop_closure else []), progress]
        with open_outputs(request) as opened, stop_on_signals() as stop:
            outputs = [*opened.outputs, *own]
            frame_source = FrameSource(camera)
            result = run_replay(
                config, camera, frame_source, outputs, stop, loop_closure or NullLoopClosure()
            )
        for output in own:
            output.close()
        truth = camera.ground_truth
        frames_s = camera.recording.frames.stamps_s
        loop_closure_summary = (
            summarize_loop_closure(loop_closure, truth, frames_s) if loop_closure else None
        )
        summary = RunSummary.from_run(
            result.statistics,
            camera.counters,
            recorder.trajectory,
            truth,
            frames_s,
            loop_closure_summary,
        )
    if loop_closure and args.optimized_trajectory:
        write_optimized_trajectory(
            args.optimized_trajectory, loop_closure.trajectory, recorder.publish_offset_s
        )
    print(json.dumps(summary.as_json()) if args.json else summary.as_table())
    result.check_has_motion(str(args.folder))
    return result.exit_code


def _check_not_overwriting_recording(args: argparse.Namespace) -> None:
    """Raise InputError if an output would be written over one of the recording's files."""
    for path in (args.trajectory, args.optimized_trajectory, args.mcap):
        if path is not None and path.exists():
            recording = args.folder.resolve()
            is_listed = any(path.resolve().match(pattern) for pattern in RECORDING_FILES)
            inside = path.resolve().is_relative_to(recording) and is_listed
            if inside or path.resolve() == recording:
                raise InputError(f"{path}: belongs to the recording; name another file")
