"""``kinect-vo run``: the odometry as a service, for as long as the robot is on."""

import argparse
import sys
from contextlib import closing, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path

from drivers.camera import Pace, RgbdCamera
from drivers.errors import InputError
from drivers.memory import release_memory
from vo_service.app import OutputRequest, Surroundings, live_service, opened_outputs
from vo_service.cameras import CameraRequest, make_camera
from vo_service.commands.kernels import loops_are_prepared, prepare_kernels, prepare_loops
from vo_service.commands.options import (
    add_camera_options,
    add_config_options,
    add_output_options,
    add_prefix_option,
    config_of,
    pace,
)
from vo_service.config import Config
from vo_service.control.inbox import Inbox
from vo_service.interrupts import Hangup, Stop, ended_by_force, hangups, stop_on_signals
from vo_service.live_loop import run_live
from vo_service.logs import set_level
from vo_service.mapping.live.opening import open_mapper
from vo_service.notify import SystemdOutput
from vo_service.numbered_files import put_aside
from vo_service.outputs.progress_output import ProgressOutput
from vo_service.outputs.state_log_output import StateLogOutput
from vo_service.outputs.zenoh_commands import commands_for
from vo_service.outputs.zenoh_log import refusals_logged
from vo_service.outputs.zenoh_opening import KeepTrying
from vo_service.outputs.zenoh_output import Extras
from vo_service.recorder.opening import open_recorder
from vo_service.reload import Reloader
from vo_service.terminal import Terminal
from vo_service.types import Command, Output

NAME = "run"
HELP = "run the odometry as a service, until Ctrl-C or SIGTERM"
EPILOG = """\
examples:
  kinect-vo run --camera freenect --rerun serve
  kinect-vo run --camera synthetic
  kinect-vo run --camera tum:recordings/desk --rerun serve
  kinect-vo run --config /etc/kinect-vo/kinect.toml

A camera that goes away is waited for: the status then says no_camera, and why. So it does when a
recording has ended. A port that is taken and a router that is away are waited for too. SIGHUP reads
the file of --config again; without one it ends the service, as a terminal that is closed does. A
trajectory that is there already is kept as FILE-0001, FILE-0002 and so on. Ctrl-C and SIGTERM are
the way to end it, within 5 seconds, with exit code 0.
"""
# From being asked to end until the process is gone.
LONGEST_ENDING_S = 4.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_config_options(parser)
    add_camera_options(parser)
    parser.add_argument(
        "--pace", type=pace, metavar="PACE", default=Pace.REALTIME,
        help="realtime (default), or lockstep for a recording",
    )  # fmt: skip
    add_prefix_option(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until stopped."""
    config = config_of(args)
    set_level(config.log.level)
    _keep_trajectory(args.trajectory)
    terminal = Terminal()
    camera = _camera(args, config)
    with (
        stop_on_signals() as stop,
        hangups() as hangup,
        ended_by_force(stop, LONGEST_ENDING_S),
        suppress(KeyboardInterrupt),
    ):
        camera.prepare()
        prepare_kernels(config, terminal, stop)
        if config.map.enabled and config.map.loops and not loops_are_prepared():
            prepare_loops(terminal, stop)
        _serve(args, config, camera, terminal, stop, hangup)
    return 0


def _serve(
    args: argparse.Namespace,
    config: Config,
    camera: RgbdCamera,
    terminal: Terminal,
    stop: Stop,
    hangup: Hangup,
) -> None:
    """Put the parts together, run the loop, and take them apart: the last one opened first."""
    inbox: Inbox[Command] = Inbox()
    reloader = Reloader(config, lambda: config_of(args))
    systemd = SystemdOutput()
    commands = commands_for(config.commands, inbox)
    request = OutputRequest(
        pace=args.pace,
        zenoh=None if args.no_publish else config.zenoh,
        way_to_open=KeepTrying,
        extras=Extras(commands, config.ros2),
        recorder=partial(open_recorder, config.recorder, asdict(config)),
        mapper=partial(open_mapper, config.map),
        rerun=config.rerun,
        trajectory=args.trajectory,
        tell=terminal.say,
    )
    with (
        refusals_logged(config.zenoh),
        opened_outputs(request) as opened,
        closing(systemd),
        closing(inbox),
    ):
        told: list[Output] = [systemd, StateLogOutput(), ProgressOutput(terminal, "run", None)]
        live = live_service(
            config,
            camera,
            Surroundings(
                outputs=[*opened.outputs, *told],
                inbox=inbox,
                recorder=opened.recorder,
                mapper=opened.mapper,
                viewers=opened.viewers,
                others=[reloader],
                on_commands=commands.configure,
            ),
        )

        def reload() -> None:
            with systemd.reloading():
                inbox.order(live.reconfigure(reloader.reload()))

        # Without a file there is nothing to read again: the terminal has gone.
        on_hangup = stop.request if args.config is None else reload
        release_memory()  # all kernels are there
        run_live(live.service.run, stop, hangup, on_hangup)


def _keep_trajectory(path: Path | None) -> None:
    """What an earlier run has written is kept as FILE-0001 and so on. Raises InputError."""
    if path is not None and path.is_file():
        try:
            put_aside(path, files_kept=sys.maxsize)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be put aside: {error.strerror}; name another file"
            ) from error


def _camera(args: argparse.Namespace, config: Config) -> RgbdCamera:
    return make_camera(
        CameraRequest(
            source=args.camera or config.camera.source,
            file=args.camera_file or config.camera.file,
            pace=args.pace,
            sensor=config.sensor,
            synthetic=config.synthetic,
        )
    )
