"""``kinect-vo run``: run the odometry as a service."""

import logging
import math
import sys
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import zenoh

from drivers.camera import PlaybackMode, RgbdCamera
from drivers.core.files import rotate_file
from drivers.core.memory import limit_freed_memory
from drivers.core.write_errors import creating
from drivers.registry import open_camera
from vo_service.app import (
    OutputsConfig,
    ServiceDependencies,
    apply_changes,
    build_live_service,
    check_files_differ,
    make_velocity_commands,
    make_velocity_subscription,
    make_wheel_odometry,
    make_wheel_subscription,
    open_frames,
    open_mapper,
    open_outputs,
    open_recorder,
    open_scans,
    open_sensor_memory,
)
from vo_service.cli.kernels import compile_kernels, first_parts
from vo_service.cli.options import (
    CameraFile,
    CameraSource,
    ConfigFile,
    McapFile,
    Method,
    NoPublish,
    Profile,
    RerunTargets,
    Timing,
    Topics,
    TrajectoryFile,
    at_pace,
    load_config,
    parse_playback_mode,
)
from vo_service.cli.request import CommandRequest, config_option, option
from vo_service.config import Config, ConfigReloader
from vo_service.control import CommandQueue
from vo_service.kernels.loading import loading_in_background
from vo_service.outputs.progress import ProgressOutput
from vo_service.outputs.state_log import StateLogOutput
from vo_service.outputs.systemd import SystemdOutput
from vo_service.outputs.zenoh.output import ConnectWithRetry
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints, make_command_endpoint
from vo_service.signals import (
    ReloadSignal,
    StopSignal,
    force_exit_after,
    reload_on_sighup,
    run_on_loop_thread,
    stop_on_signals,
)
from vo_service.terminal import Terminal, set_log_level
from vo_service.types.commands import ReloadConfig
from vo_service.types.outputs import Output
from vo_service.wheel_odometry.wheel_odometry import WheelOdometrySource

logger = logging.getLogger(__name__)

EPILOG = """\
examples:
  kinect-vo run --camera freenect --rerun serve
  kinect-vo run --camera synthetic
  kinect-vo run --camera tum:recordings/desk --rerun serve
  kinect-vo run --config /etc/kinect-vo/kinect.toml

If the camera disconnects, the service waits for it and reports no_camera with the reason; also when
a recording has ended. It also waits for a port that is taken and for a router that is away. SIGHUP
reloads the file of --config; without --config it ends the service, as closing the terminal does. An
existing file of --trajectory or --mcap is kept as FILE-0001, FILE-0002 and so on. Ctrl-C or SIGTERM
ends the service within 5 seconds, with exit code 0.
"""
# Time from the stop request to the end of the process.
MAX_SHUTDOWN_S = 4.5


@dataclass(frozen=True, kw_only=True)
class RunServiceRequest(CommandRequest):
    """The camera, the odometry, and what becomes of its results."""

    config: ConfigFile = None
    method: Method = None
    timing: Timing = None
    profile: Profile = None
    camera: CameraSource = None
    camera_file: CameraFile = None
    topics: Topics = None
    pace: PlaybackMode = option(
        "realtime (default), or lockstep for a recording",
        PlaybackMode.REALTIME,
        "PACE",
        parse_playback_mode,
    )
    prefix: Annotated[str | None, config_option("zenoh.prefix", metavar="PREFIX")] = None
    trajectory: TrajectoryFile = None
    mcap: McapFile = None
    rerun: RerunTargets = ()
    no_publish: NoPublish = False

    def load(self) -> Config:
        """Read the configuration, at the start and again for each reload."""
        return at_pace(load_config(self.config, self), self.pace)


def run(request: RunServiceRequest) -> int:
    """Run the service until stopped."""
    limit_freed_memory()  # it costs time, so other commands go without
    config = request.load()
    set_log_level(config.log.level)
    trajectory = request.trajectory
    check_files_differ(config.rerun, trajectory, request.mcap or config.outputs.mcap)
    if trajectory is not None and trajectory.is_file():
        with creating(trajectory):  # rename that of an earlier run to FILE-0001 and so on
            rotate_file(trajectory, max_files=sys.maxsize)
    terminal = Terminal(log_period_s=math.inf)  # a service logs only changes
    source = request.camera or config.camera.source
    camera = open_camera(
        source,
        camera_file=config.camera.file,
        playback_mode=request.pace,
        sensor=config.sensor,
        synthetic=config.synthetic,
        topics=request.topics,
    )
    with (
        stop_on_signals() as stop,
        reload_on_sighup() as reload_signal,
        force_exit_after(stop, MAX_SHUTDOWN_S),
        suppress(KeyboardInterrupt),
    ):
        compile_kernels(first_parts(config, source), terminal, stop)
        camera.prepare()
        with loading_in_background(config.odometry.method):
            _serve(request, config, camera, terminal, stop, reload_signal)
    return 0


def _serve(
    request: RunServiceRequest,
    config: Config,
    camera: RgbdCamera,
    terminal: Terminal,
    stop: StopSignal,
    reload_signal: ReloadSignal,
) -> None:
    """Open the parts, run the loop, and close the parts in reverse order."""
    zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
    command_queue = CommandQueue()
    commands = make_command_endpoint(config.commands, command_queue)
    wheel_odometry = make_wheel_odometry(config, camera)
    velocities = make_velocity_commands(config, camera)
    subscriptions = (
        make_wheel_subscription(config, wheel_odometry),
        make_velocity_subscription(config, camera, velocities),
    )
    endpoints = ExtraEndpoints(commands, config.ros2, subscriptions)
    reloader = ConfigReloader(config, request.load)
    outputs_config = _make_outputs_config(request, config, endpoints, wheel_odometry, terminal)
    with (
        open_outputs(outputs_config) as opened,
        closing(open_sensor_memory(config, camera)) as sensor_memory,
        closing(SystemdOutput()) as systemd,
        closing(command_queue),
    ):
        loggers: list[Output] = [systemd, StateLogOutput(), ProgressOutput(terminal, "run", None)]
        dependencies = ServiceDependencies(
            opened=opened,
            more_outputs=[sensor_memory, *loggers],
            command_queue=command_queue,
            sensor_memory=sensor_memory,
            wheel_odometry=wheel_odometry,
            warning_sources=[reloader, velocities],
            add_scan=open_scans(config, outputs_config),
            on_command_config=commands.configure,
        )
        service, handlers = build_live_service(config, camera, dependencies)

        def reload() -> None:
            with systemd.notify_reloading():
                changes = reloader.reload()
                command_queue.submit_internal(
                    ReloadConfig(partial(apply_changes, changes, handlers))
                )

        # Without --config, SIGHUP means that the terminal was closed.
        on_reload = stop.request if request.config is None else reload
        run_on_loop_thread(service.run, stop, reload_signal, on_reload)
        if reason := service.statistics.failure_reasons.no_motion_reason:
            logger.warning("%s: %s", camera.name, reason)


def _make_outputs_config(
    request: RunServiceRequest,
    config: Config,
    endpoints: ExtraEndpoints,
    wheel_odometry: WheelOdometrySource,
    terminal: Terminal,
) -> OutputsConfig:
    return OutputsConfig(
        playback_mode=request.pace,
        zenoh=None if request.no_publish else config.zenoh,
        frames=partial(open_frames, config),
        T_base_camera=config.T_base_camera.T_base_camera,
        connect_policy=ConnectWithRetry,
        extra_endpoints=endpoints,
        recorder=partial(open_recorder, config, wheel_odometry.open_journal().take),
        mapper=partial(open_mapper, config),
        rerun=config.rerun,
        extra=config.outputs.extra,
        mcap=request.mcap or config.outputs.mcap,
        trajectory=request.trajectory,
        wheel_messages=wheel_odometry.open_journal().take,
        log_line=terminal.write_line,
    )
