"""``kinect-vo run``: the odometry as a service, for as long as the robot is on."""

import argparse
from contextlib import suppress

from drivers.camera import Pace
from vo_service.cameras import CameraRequest, make_camera
from vo_service.commands.options import (
    add_camera_options,
    add_config_options,
    add_output_options,
    config_of,
    pace,
)
from vo_service.config import Config
from vo_service.feed import PersistentFeed
from vo_service.interrupts import stop_on_signals
from vo_service.outputs.opening import OutputRequest, opened_outputs
from vo_service.outputs.progress_output import ProgressOutput
from vo_service.outputs.state_log_output import StateLogOutput
from vo_service.session import prepare_kernels, run_loop
from vo_service.terminal import Terminal

NAME = "run"
HELP = "run the odometry as a service, until Ctrl-C or SIGTERM"
EPILOG = """\
examples:
  kinect-vo run --camera freenect --rerun serve
  kinect-vo run --camera synthetic
  kinect-vo run --camera tum:recordings/desk --rerun serve
  kinect-vo run --config /etc/kinect-vo/kinect.toml

A camera that goes away is waited for: the status then says no_camera, and why. So it does when a
recording has ended. Ctrl-C and SIGTERM are the way to end it, with exit code 0.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_config_options(parser)
    add_camera_options(parser)
    parser.add_argument(
        "--pace", type=pace, metavar="PACE", default=Pace.REALTIME,
        help="realtime (default), or lockstep for a recording",
    )  # fmt: skip
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until stopped."""
    config = config_of(args)
    terminal = Terminal()
    with suppress(KeyboardInterrupt):
        prepare_kernels(config, terminal)
        _serve(args, config, terminal)
    return 0


def _serve(args: argparse.Namespace, config: Config, terminal: Terminal) -> None:
    with stop_on_signals() as stop:
        progress = stop.interrupting(terminal.counter("rendering the room: frame"))
        camera = make_camera(
            CameraRequest(
                source=args.camera or config.camera.source,
                file=args.camera_file or config.camera.file,
                pace=args.pace,
                sensor=config.sensor,
                synthetic=config.synthetic,
                progress=progress,
            )
        )
        request = OutputRequest(
            pace=args.pace,
            zenoh=None if args.no_publish else config.zenoh,
            rerun_targets=config.rerun.targets,
            trajectory=args.trajectory,
            tell=terminal.say,
        )
        with opened_outputs(request) as outputs:
            outputs += [StateLogOutput(), ProgressOutput(terminal, "run", None)]
            run_loop(config, camera, PersistentFeed(camera), outputs, stop)
