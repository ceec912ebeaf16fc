"""The composition root: the one file that knows all parts of the service and puts them together.

A replay is `run_replay`; the service on a robot is `build_live_service`. Both run `Service`.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from drivers.camera import Clock, PlaybackMode, RgbdCamera
from drivers.core import CameraError, InputError, UserFacingError
from drivers.core.geometry import T_BODY_CAMERA, Array
from drivers.core.memory import release_memory
from drivers.registry import make_reconnecting
from vo_service.config import Config, ConfigChanges
from vo_service.config_tables import CommandConfig, RerunConfig, ZenohConfig
from vo_service.control import CommandQueue, Control, LoadShedder
from vo_service.frame_source import FrameSource, LiveSource, make_publish_clock
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.outputs.zenoh.base_subscription import (
    BaseSubscription,
    velocity_key,
    wheel_key,
)
from vo_service.outputs.zenoh.output import (
    LIVE_QOS,
    LOCKSTEP_QOS,
    ConnectOnce,
    ConnectPolicy,
    ZenohOutput,
)
from vo_service.outputs.zenoh.session_endpoints import (
    ExtraEndpoints,
    Subscribe,
    subscribe_to_nothing,
)
from vo_service.service import OdometryMethod, Service, ServiceInput, ServiceOutputs
from vo_service.service_statistics import ServiceStatistics
from vo_service.signals import StopSignal
from vo_service.terminal import set_log_level
from vo_service.types.odometry import DeferredWork, Odometry
from vo_service.types.odometry_update import AddScan, WheelMessageSource, add_no_scan
from vo_service.types.outputs import (
    GroundTruthSource,
    HasWarning,
    LoopClosure,
    Mapper,
    NullLoopClosure,
    NullMapper,
    NullRecorder,
    NullSensorMemory,
    Output,
    PausableViewer,
    Recorder,
    SensorMemory,
    no_ground_truth,
)
from vo_service.velocity_commands import VelocityCommands
from vo_service.wheel_odometry.recorded_wheels import RecordedWheelOdometry, recorded_topics
from vo_service.wheel_odometry.wheel_odometry import (
    NullWheelOdometry,
    WheelOdometry,
    WheelOdometrySource,
)

logger = logging.getLogger(__name__)

if TYPE_CHECKING:
    from vo_service.outputs.frames.output import FrameOutput
    from vo_service.outputs.rerun.output import RerunOutput

# By each key of `config.RELOADABLE_KEYS`: the function that applies a changed value.
ConfigHandlers = Mapping[str, Callable[[Config], None]]


@runtime_checkable
class HasFeatureCount(Protocol):
    """An odometry whose number of features may change while it runs."""

    feature_count: int


@dataclass(frozen=True)
class OutputsConfig:
    """Choice of the outputs to open.

    Attributes:
        playback_mode: In lockstep, every pose reaches every subscriber, in order.
        zenoh: Settings of the publisher; None: do not publish.
        connect_policy: Whether to retry if the Zenoh session cannot be opened.
        extra_endpoints: Further endpoints of the session, such as commands.
        frames: Makes the output of images and points, on the same session; None: no output.
        wait_for_subscriber_s: Time to wait for the first subscriber, s; 0 = do not wait.
        recorder: Makes the flight recorder; None: no flight recorder.
        mapper: Makes the mapper; None: no mapper.
        rerun: Targets and settings of the viewer.
        extra: Further outputs, see `ExtraOutputsConfig`.
        mcap: MCAP file to record; None: no file.
        trajectory: Trajectory file to write; None: no file.
        T_base_camera: 4x4 pose of the optical camera in the base, for the MCAP file.
        ground_truth: Returns the ground truth for the viewer; called after the first frame.
        wheel_messages: Returns the messages of the wheels since its last call, for the MCAP file.
        log_line: Shows a line with an output's address to the user.
    """

    playback_mode: PlaybackMode
    zenoh: ZenohConfig | None
    connect_policy: ConnectPolicy = ConnectOnce
    extra_endpoints: ExtraEndpoints = field(default_factory=ExtraEndpoints)
    frames: "Callable[[], list[FrameOutput]] | None" = None
    wait_for_subscriber_s: float = 0.0
    recorder: Callable[[], Recorder] | None = None
    mapper: Callable[[], Mapper] | None = None
    rerun: RerunConfig = RerunConfig()  # noqa: RUF009 (frozen)
    extra: Sequence[str] = ()
    mcap: Path | None = None
    trajectory: Path | None = None
    T_base_camera: Array = field(default_factory=T_BODY_CAMERA.copy)
    ground_truth: GroundTruthSource = no_ground_truth
    wheel_messages: WheelMessageSource = tuple
    log_line: Callable[[str], None] = logger.info


@dataclass
class OutputSet:
    """The open outputs, and those among them that take commands.

    Attributes:
        outputs: All outputs.
        viewers: The outputs that load shedding may pause.
        recorder: The flight recorder.
    """

    outputs: list[Output] = field(default_factory=list)
    viewers: list[PausableViewer] = field(default_factory=list)
    recorder: Recorder = field(default_factory=NullRecorder)
    mapper: Mapper = field(default_factory=NullMapper)


def check_files_differ(rerun: RerunConfig, *files: Path | None) -> None:
    """Check the outputs before anything is written.

    Args:
        rerun: With the targets of the viewer.
        files: The other files; None is no file.

    Raises:
        InputError: Two outputs would be written to the same file.
    """
    seen = {Path(target).resolve() for target in rerun.targets if target.endswith(".rrd")}
    for file in filter(None, files):
        if file.resolve() in seen:
            raise InputError(f"{file}: two outputs would be written to it; name another file")
        seen.add(file.resolve())


@contextmanager
def open_outputs(config: OutputsConfig) -> Iterator[OutputSet]:
    """Open all outputs, and close them in reverse order.

    The trajectory file is opened last: an existing one is kept until all other outputs are open.

    Raises:
        UserFacingError: If an output cannot be opened.
    """
    with ExitStack() as stack:
        opened = OutputSet()
        outputs = opened.outputs
        if config.zenoh is not None:
            outputs += _open_zenoh(config, config.zenoh, stack)
        if config.rerun.targets:
            viewers = _open_viewers(config, stack)
            outputs += viewers
            opened.viewers += viewers
        if config.recorder is not None:
            opened.recorder = stack.enter_context(closing(config.recorder()))
            outputs.append(opened.recorder)
        if config.mapper is not None:
            opened.mapper = stack.enter_context(closing(config.mapper()))
            outputs.append(opened.mapper)
        # An output that may be left out is imported where it is opened.
        if config.extra:
            from vo_service.outputs.extra_output import ExtraOutput

            extra = [ExtraOutput(source, config.playback_mode) for source in config.extra]
            outputs += [stack.enter_context(closing(output)) for output in extra]
        if config.mcap is not None:
            outputs.append(stack.enter_context(closing(_open_mcap(config, config.mcap))))
        if config.trajectory is not None:
            from vo_service.outputs.trajectory.trajectory_file import open_trajectory

            file = open_trajectory(str(config.trajectory), config.playback_mode)
            outputs.append(stack.enter_context(closing(file)))
        yield opened


def open_frames(config: Config) -> "list[FrameOutput]":
    """Open the output of images, points and scans; nothing if they are not to be published.

    Raises:
        InputError: The configuration of Zenoh is not valid.
    """
    if config.frames.enabled is False and not config.scan.enabled:
        return []
    from vo_service.outputs.frames.output import FrameOutputConfig, open_frame_outputs

    settings = FrameOutputConfig(
        prefix=config.zenoh.prefix,
        frames=config.frames,
        has_scan=config.scan.enabled,
        T_base_camera=config.T_base_camera.T_base_camera,
        frame_ids=config.ros2,
    )
    return open_frame_outputs(settings, config.zenoh)


def open_scans(config: Config, outputs: OutputsConfig) -> AddScan:
    """Open the scans of the frames; none if they are disabled.

    Their kernels are loaded at once if the scan of each frame is wanted, else later.
    """
    if config.scan.enabled is False:
        return add_no_scan
    from vo_service.navigation.frame_scans import FrameScans

    scans = FrameScans(config.scan, config.T_base_camera.T_base_camera, config.ros2.scan_frame_id)
    is_kept = outputs.mcap is not None or bool(outputs.rerun.targets)
    is_published = outputs.zenoh is not None and config.scan.enabled
    if is_published or (is_kept and scans.is_above_floor):
        scans.load()
    return scans.add_to


def open_recorder(config: Config, wheel_messages: WheelMessageSource = tuple) -> Recorder:
    """Open the flight recorder; a `NullRecorder` if it is disabled or fails."""
    if not config.has_recorder:
        return NullRecorder("the recorder is switched off (recorder.enabled, odometry.profile)")
    from vo_service.outputs.recorder.client import open_recorder

    return open_recorder(config.recorder, asdict(config), wheel_messages)


def open_mapper(config: Config) -> Mapper:
    """Open the mapper; a `NullMapper` if it is disabled or fails."""
    if not config.map.enabled:
        return NullMapper("the map is disabled (map.enabled)")
    from vo_service.slam.mapper.client import open_mapper

    return open_mapper(config.map, config.scan, config.T_base_camera.T_base_camera)


def make_wheel_odometry(config: Config, camera: RgbdCamera) -> WheelOdometrySource:
    """Make the odometry of the wheels; a `NullWheelOdometry` if it is disabled.

    That of a recording is read from it, that of a live camera is sent over Zenoh.
    """
    if not config.wheel_odometry.enabled:
        return NullWheelOdometry()
    if camera.clock is Clock.RECORDED:
        topics = recorded_topics(config.wheel_odometry)
        open_messages = partial(camera.recorded_odometry, topics)
        return RecordedWheelOdometry(config.wheel_odometry, " or ".join(topics), open_messages)
    return WheelOdometry(config.wheel_odometry, wheel_key(config.zenoh.prefix))


def make_wheel_subscription(config: Config, wheel_odometry: WheelOdometrySource) -> Subscribe:
    """Make what subscribes to the messages of the wheels."""
    if isinstance(wheel_odometry, NullWheelOdometry | RecordedWheelOdometry):
        return subscribe_to_nothing
    return BaseSubscription(wheel_key(config.zenoh.prefix), wheel_odometry.add_message).declare


def make_velocity_commands(config: Config, camera: RgbdCamera) -> VelocityCommands:
    """Make what drives the base of the camera."""
    return VelocityCommands(camera, velocity_key(config.zenoh.prefix))


def make_velocity_subscription(
    config: Config, camera: RgbdCamera, velocities: VelocityCommands
) -> Subscribe:
    """Make what subscribes to velocities; to nothing if the camera cannot be driven."""
    if not camera.can_drive:
        return subscribe_to_nothing
    return BaseSubscription(velocity_key(config.zenoh.prefix), velocities.add_message).declare


def open_sensor_memory(config: Config, camera: RgbdCamera) -> SensorMemory:
    """Open the memory of sensors; a `NullSensorMemory` if it is off, fails, or has no sensor."""
    if camera.clock is Clock.RECORDED:
        return NullSensorMemory()
    from vo_service.sensor_memory import open_sensor_memory

    return open_sensor_memory(config.odometry.timing)


def _open_mcap(config: OutputsConfig, path: Path) -> Output:
    from drivers.playback.recording_formats import check_bag_packages

    check_bag_packages(path)
    from vo_service.outputs.mcap_recording import open_mcap_recording

    return open_mcap_recording(
        path,
        config.playback_mode,
        config.ground_truth,
        config.wheel_messages,
        config.T_base_camera,
    )


def _open_zenoh(config: OutputsConfig, zenoh: ZenohConfig, stack: ExitStack) -> list[Output]:
    """Open the publisher of the poses and, on the same session, that of the frames."""
    is_lockstep = config.playback_mode is PlaybackMode.LOCKSTEP
    delivery = LOCKSTEP_QOS if is_lockstep else LIVE_QOS
    endpoints = config.extra_endpoints
    frame_outputs = [] if config.frames is None else config.frames()
    for frames in frame_outputs:
        endpoints = replace(endpoints, on_session=frames.declare, on_pose=frames.queue)
    publisher = stack.enter_context(
        closing(ZenohOutput(zenoh, delivery, config.connect_policy, endpoints))
    )
    for frames in frame_outputs:
        stack.enter_context(closing(frames))  # before the session
    if not publisher.warning:  # the warning names what prevents publishing
        config.log_line(f"poses: {publisher.description}")
    if config.wait_for_subscriber_s:
        publisher.wait_for_subscriber(config.wait_for_subscriber_s)
    return [publisher, *frame_outputs]


def _open_viewers(config: OutputsConfig, stack: ExitStack) -> "list[RerunOutput]":
    """Open the Rerun targets; nothing of Rerun is imported without one."""
    from vo_service.outputs.rerun.output import open_rerun_output
    from vo_service.outputs.rerun.targets import check_targets

    check_targets(config.rerun.targets)
    viewers = []
    for target in config.rerun.targets:
        viewer = open_rerun_output(target, config.rerun, config.ground_truth, config.playback_mode)
        viewers.append(stack.enter_context(closing(viewer)))
        config.log_line(f"Rerun: {viewer.address}")
    return viewers


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes:
        statistics: Counts and times.
        exit_code: 0, or the shell's exit code for a program ended by a signal.
    """

    statistics: ServiceStatistics
    exit_code: int

    def check_has_motion(self, name: str) -> None:
        """Raise UserFacingError if a recording, `name`, was read to its end without any motion."""
        reason = self.statistics.failure_reasons.no_motion_reason
        if reason and not self.exit_code:
            raise UserFacingError(f"{name}: {reason}")


def run_replay(
    config: Config,
    camera: RgbdCamera,
    frame_source: FrameSource,
    outputs: Sequence[Output],
    stop: StopSignal,
    loop_closure: LoopClosure = NullLoopClosure(),  # noqa: B008 (it has no state)
    wheel_odometry: WheelOdometrySource = NullWheelOdometry(),  # noqa: B008 (the same)
    add_scan: AddScan = add_no_scan,
) -> RunResult:
    """Run the service on a recording until the frames end or a stop is requested.

    Args:
        config: The configuration.
        outputs: Take updates and the status.
        loop_closure: Corrects the transform from map to odom.
        wheel_odometry: The motion of the base by its wheels.
        add_scan: Adds the scan to the updates.
    """
    method = _make_method(config)
    odom_frame = OdomFrame(config.T_base_camera.T_base_camera, config.base.planar, wheel_odometry)
    service = Service(
        _make_input(config, camera, frame_source),
        replace(method, odometry=loop_closure.wrap(method.odometry)),
        odom_frame,
        Control(odom_frame, camera),
        ServiceOutputs(outputs, warning_sources=(wheel_odometry,)),
        loop_closure,
        add_scan,
    )
    release_memory()  # all kernels are loaded
    service.run(stop.event)
    return RunResult(service.statistics, stop.exit_code)


def _make_method(config: Config) -> OdometryMethod:
    timer, deferred = CpuStageTimer(), DeferredWork()
    odometry = config.odometry.make_odometry(timer, deferred)
    return OdometryMethod(config.odometry.method, odometry, timer, deferred)


def _make_input(config: Config, camera: RgbdCamera, frame_source: FrameSource) -> ServiceInput:
    clock = make_publish_clock(camera.clock, config.camera.stamp_offset_s)
    return ServiceInput(camera, frame_source, clock)


@dataclass
class ServiceDependencies:
    """Dependencies of the live service, apart from the camera.

    Attributes:
        opened: The outputs that the user chose.
        more_outputs: Others that take updates and the status.
        command_queue: Commands for the loop.
        sensor_memory: The memory of learned timings, one of the other outputs.
        wheel_odometry: The motion of the base by its wheels.
        warning_sources: Parts besides the outputs whose warnings are in the status.
        add_scan: Adds the scan to the updates.
        on_command_config: Applies a changed table `[commands]`.
    """

    opened: OutputSet
    more_outputs: Sequence[Output] = ()
    command_queue: CommandQueue = field(default_factory=CommandQueue)
    sensor_memory: SensorMemory = field(default_factory=NullSensorMemory)
    wheel_odometry: WheelOdometrySource = field(default_factory=NullWheelOdometry)
    warning_sources: Sequence[HasWarning] = ()
    add_scan: AddScan = add_no_scan
    on_command_config: Callable[[CommandConfig], None] = lambda _: None


def build_live_service(
    config: Config, camera: RgbdCamera, dependencies: ServiceDependencies
) -> tuple[Service, ConfigHandlers]:
    """Build the service for a live camera, which may disconnect and reconnect.

    Args:
        config: The configuration.
        camera: The camera; the service opens it.
        dependencies: Outputs, commands and the parts that take them.

    Returns:
        The loop, and the functions that apply a changed configuration on its thread.
    """
    camera = make_reconnecting(camera)
    method = _make_method(config)
    odom_frame = OdomFrame(
        config.T_base_camera.T_base_camera, config.base.planar, dependencies.wheel_odometry
    )
    opened, mapper = dependencies.opened, dependencies.opened.mapper
    load_shedder = LoadShedder(opened.viewers)
    load_shedder.configure(config.load)
    frame_source = LiveSource(camera, dependencies.sensor_memory.apply)
    service = Service(
        _make_input(config, camera, frame_source),
        replace(method, odometry=mapper.loop_closure.wrap(method.odometry)),
        odom_frame,
        Control(odom_frame, camera, dependencies.command_queue, opened.recorder, mapper),
        ServiceOutputs(
            [*opened.outputs, *dependencies.more_outputs],
            load_shedder,
            (*dependencies.warning_sources, dependencies.wheel_odometry),
        ),
        mapper.loop_closure,
        dependencies.add_scan,
    )
    return service, make_config_handlers(camera, method.odometry, load_shedder, dependencies)


def make_config_handlers(
    camera: RgbdCamera,
    odometry: Odometry,
    load_shedder: LoadShedder,
    dependencies: ServiceDependencies,
) -> ConfigHandlers:
    """Make the handler of each reloadable key. They run on the loop's thread.

    Args:
        odometry: Takes the number of features, if its method has features.
        dependencies: Recorder, mapper and commands.
    """

    def features(config: Config) -> None:
        if isinstance(odometry, HasFeatureCount):
            odometry.feature_count = config.odometry.feature_count

    def tilt(config: Config) -> None:
        if config.sensor.tilt_deg is not None:
            camera.set_tilt_deg(config.sensor.tilt_deg)

    def recorder(config: Config) -> None:
        dependencies.opened.recorder.configure(config.recorder)

    def mapper(config: Config) -> None:
        dependencies.opened.mapper.configure(config.map)

    return {
        "sensor.led": lambda config: camera.set_led(config.sensor.led),
        "sensor.tilt_deg": tilt,
        "odometry.feature_count": features,
        "load.adapt": lambda config: load_shedder.configure(config.load),
        "commands.per_second": lambda config: dependencies.on_command_config(config.commands),
        "recorder.save_on_loss": recorder,
        "recorder.total_mb": recorder,
        "map.max_mb": mapper,
        "map.voxel_m": mapper,
        "map.mesh_memory_mb": mapper,
        "map.total_mb": mapper,
        "log.level": lambda config: set_log_level(config.log.level),
    }


def apply_changes(changes: ConfigChanges, handlers: ConfigHandlers) -> None:
    """Call each handler of a changed key once. A camera's refusal is logged as a warning."""
    for apply in dict.fromkeys(handlers[key] for key in changes.reloaded_keys):
        try:
            apply(changes.config)
        except CameraError as error:
            logger.warning("%s", error)
