"""``kinect-vo demo``: run the odometry on the virtual Kinect and show the results."""

import json
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from drivers.camera import PlaybackMode
from drivers.core.files import atomic_write
from drivers.core.geometry import Trajectory, format_trajectory
from drivers.core.write_errors import create_output_folder
from drivers.registry import open_camera
from drivers.synthetic.config import SyntheticConfig
from vo_service.app import OutputsConfig, open_frames, open_outputs, open_scans, run_replay
from vo_service.cli.kernels import compile_kernels, prepare_kernels
from vo_service.cli.options import (
    ConfigFile,
    Method,
    NoPublish,
    Timing,
    load_config,
    parse_seconds,
    print_message,
)
from vo_service.cli.request import CommandRequest, flag, option
from vo_service.frame_source import PacedSource
from vo_service.outputs.progress import ProgressOutput
from vo_service.outputs.trajectory.trajectory_file import TrajectoryRecorder
from vo_service.outputs.zenoh.free_port import ConnectOnFreePort
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.evaluation.metrics import MIN_MATCHES
from vo_service.tools.evaluation.plot import write_plot
from vo_service.tools.evaluation.run_summary import RunSummary, evaluate_if_possible

EPILOG = """\
examples:
  kinect-vo demo
  kinect-vo demo --seconds 5 --output /tmp/demo

Plays a virtual room at 30 frames a second while it is rendered, in slow motion on a slow computer.
The frames are cached for the next time. Poses are published over Zenoh on this computer only;
kinect-vo listen prints them. If the default port is taken, a free one is used and printed. OUTPUT
receives trajectory.txt, groundtruth.txt, trajectory.png and, with Rerun, demo.rrd.
"""


@dataclass(frozen=True, kw_only=True)
class DemoRequest(CommandRequest):
    """The odometry, the length of the sequence, and what to show."""

    config: ConfigFile = None
    method: Method = None
    timing: Timing = None
    seconds: float = option(
        "length of the sequence (default: %(default)s)", 10.0, parse=parse_seconds
    )
    output: Path = option(
        "folder for the results (default: %(default)s)", Path("output/demo"), "FOLDER"
    )
    no_serve: bool = flag("do not serve the Rerun viewer's page during the run")
    no_publish: NoPublish = False
    json: bool = flag("print one JSON object on stdout")


def run(request: DemoRequest) -> int:
    """Play the sequence, then print the summary."""
    config = load_config(request.config, request)
    create_output_folder(request.output)
    terminal = Terminal()
    camera = open_camera(
        "synthetic", synthetic=replace(SyntheticConfig(), duration_s=request.seconds)
    )
    recorder = TrajectoryRecorder()
    with stop_on_signals() as stop:
        compile_kernels([config.odometry.method, "virtual Kinect"], terminal, stop)
    with camera:  # it prepares its room in the background
        with stop_on_signals() as stop:
            prepare_kernels(config, terminal, stop)
        outputs_config = OutputsConfig(
            playback_mode=PlaybackMode.REALTIME,
            zenoh=None if request.no_publish else config.zenoh,
            frames=partial(open_frames, config),
            connect_policy=ConnectOnFreePort,
            rerun=replace(config.rerun, targets=_choose_rerun_targets(request)),
            trajectory=request.output / "trajectory.txt",
            ground_truth=lambda: camera.ground_truth,
            log_line=print_message,
        )
        with open_outputs(outputs_config) as opened, stop_on_signals() as stop:
            progress = ProgressOutput(terminal, "demo", camera.frame_count)
            outputs = [*opened.outputs, recorder, progress]
            scans = open_scans(config, outputs_config)
            result = run_replay(config, camera, PacedSource(camera), outputs, stop, add_scan=scans)
        terminal.clear()
        truth = camera.ground_truth
        if truth is None:  # stopped before the first frame
            return result.exit_code
        evaluation = evaluate_if_possible(recorder.trajectory, truth, truth.stamps_s)
        summary = RunSummary(result.statistics, camera.counters, evaluation)
    _write_results(request.output, recorder, truth)
    print_message(f"results: {request.output}" + (" (cut short)" if result.exit_code else ""))
    print(json.dumps(summary.as_json()) if request.json else summary.as_table())
    result.check_has_motion(camera.name)
    return result.exit_code


def _choose_rerun_targets(request: DemoRequest) -> tuple[str, ...]:
    if find_spec("rerun") is None:
        print_message("Rerun: not installed (pip install 'kinect-vo[rerun]')")
        return ()
    recording = request.output / "demo.rrd"
    return (str(recording),) if request.no_serve else ("serve", str(recording))


def _write_results(folder: Path, recorder: TrajectoryRecorder, truth: Trajectory) -> None:
    """Write the ground truth, with stamps as in the trajectory file, and a plot of both."""
    shifted = format_trajectory(truth, recorder.publish_offset_s)
    atomic_write(folder / "groundtruth.txt", shifted)
    trajectory = recorder.trajectory
    if len(trajectory) >= MIN_MATCHES:
        write_plot(folder / "trajectory.png", trajectory, truth, "kinect-vo demo")
