"""The composition root: the one file that knows all parts of the service and puts them together.

A replay is `run_loop`, the service on a robot is `live_service`; both run the same `Service`.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from drivers.camera import Pace, RgbdCamera
from drivers.errors import CameraError
from drivers.memory import release_memory
from vo_service.config import Config, make_odometry
from vo_service.control.control import Control
from vo_service.control.inbox import Inbox
from vo_service.feed import Feed, PersistentFeed
from vo_service.interrupts import Stop
from vo_service.load.adjustable import AdjustableGovernor
from vo_service.logs import set_level
from vo_service.outputs.trajectory_output import TrajectoryOutput
from vo_service.outputs.worker import DropOldest, HandOver, Wait
from vo_service.outputs.zenoh_opening import OpenAtOnce, WayToOpen
from vo_service.outputs.zenoh_output import LIVE, LOCKSTEP, Extras, ZenohOutput
from vo_service.pose_tracker import PoseTracker
from vo_service.reload import Changes
from vo_service.service import Service
from vo_service.settings import CommandSettings, RerunSettings, ZenohConfig
from vo_service.stage_clock import StageClock
from vo_service.stamps import stamp_clock
from vo_service.statistics import Statistics
from vo_service.types import (
    Command,
    Loops,
    Mapper,
    NoLoops,
    NoMapper,
    NoRecorder,
    Output,
    Reconfigure,
    Recorder,
    Troubled,
    TruthSource,
    Viewer,
    no_truth,
)
from vo_service.viewer.output import open_viewer
from vo_service.viewer.targets import check_places

# Lines of the trajectory that a robot's disk may owe: five minutes.
LONGEST_HANG = 9000

# How each key that may change while the service runs is applied; see `reload.LIVE_KEYS`.
Appliers = Mapping[str, Callable[[Config], None]]

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class OutputRequest:
    """What to open.

    pace                   lockstep: every pose reaches every subscriber, in order
    zenoh                  None: do not publish
    way_to_open            what happens where the session cannot be opened now
    extras                 what else is offered on the session
    wait_for_subscriber_s  how long to wait for the first one; 0 = not at all
    recorder               makes the flight recorder; None: there is none
    mapper                 makes the mapper; None: there is none
    rerun                  where and how to show what is going on
    trajectory             file to write
    ground_truth           asked for the truth, to draw it, once frames come
    tell                   gets a line for the person who wants to look
    """

    pace: Pace
    zenoh: ZenohConfig | None
    way_to_open: WayToOpen = OpenAtOnce
    extras: Extras = field(default_factory=Extras)
    wait_for_subscriber_s: float = 0.0
    recorder: Callable[[], Recorder] | None = None
    mapper: Callable[[], Mapper] | None = None
    rerun: RerunSettings = RerunSettings()  # noqa: RUF009 (frozen)
    trajectory: Path | None = None
    ground_truth: TruthSource = no_truth
    tell: Callable[[str], None] = logger.info


@dataclass
class Opened:
    """The outputs, and those among them that can be told something."""

    outputs: list[Output] = field(default_factory=list)
    viewers: list[Viewer] = field(default_factory=list)
    recorder: Recorder = field(default_factory=NoRecorder)
    mapper: Mapper = field(default_factory=NoMapper)


@contextmanager
def opened_outputs(request: OutputRequest) -> Iterator[Opened]:
    """Open everything, close everything, the last opened first.

    The trajectory file comes last: what is there already is kept until all else has worked. Raises
    InputError if two Rerun targets are the same place, and whatever opening one raises.
    """
    check_places(request.rerun.targets)
    with ExitStack() as stack:
        opened = Opened()
        outputs = opened.outputs
        is_lockstep = request.pace is Pace.LOCKSTEP
        if request.zenoh is not None:
            delivery = LOCKSTEP if is_lockstep else LIVE
            publisher = stack.enter_context(
                closing(ZenohOutput(request.zenoh, delivery, request.way_to_open, request.extras))
            )
            outputs.append(publisher)
            if not publisher.warning:  # which says what keeps it from there
                request.tell(f"poses: {publisher.where}")
            if request.wait_for_subscriber_s:
                publisher.wait_for_subscriber(request.wait_for_subscriber_s)
        for target in request.rerun.targets:
            viewer = open_viewer(target, request.rerun, request.ground_truth, request.pace)
            stack.enter_context(closing(viewer))
            outputs.append(viewer)
            opened.viewers.append(viewer)
            request.tell(f"pictures: {viewer.address}")
        if request.recorder is not None:
            opened.recorder = stack.enter_context(closing(request.recorder()))
            outputs.append(opened.recorder)
        if request.mapper is not None:
            opened.mapper = stack.enter_context(closing(request.mapper()))
            outputs.append(opened.mapper)
        if request.trajectory is not None:
            lines: HandOver[bytes] = Wait(64) if is_lockstep else DropOldest(LONGEST_HANG)
            trajectory = TrajectoryOutput(request.trajectory, lines)
            outputs.append(stack.enter_context(closing(trajectory)))
        yield opened


@dataclass(frozen=True)
class Ending:
    """How a run ended, and its figures."""

    statistics: Statistics
    exit_code: int  # 0, or the shell's for a program that a signal ended


def run_loop(
    config: Config,
    camera: RgbdCamera,
    feed: Feed,
    outputs: Sequence[Output],
    stop: Stop,
    loops: Loops = NoLoops(),  # noqa: B008 (it has no state)
) -> Ending:
    """Run until the frames end or `stop` is set."""
    service = _service(config, camera, feed, outputs, loops)
    release_memory()  # all kernels are there
    service.run(stop.event)
    return Ending(service.statistics, stop.exit_code)


def _service(
    config: Config, camera: RgbdCamera, feed: Feed, outputs: Sequence[Output], loops: Loops
) -> Service:
    stages = StageClock()
    tracker = PoseTracker(config.T_base_camera.T_base_camera)
    return Service(
        feed=feed,
        odometry=loops.around(make_odometry(config.odometry, stages)),
        stages=stages,
        tracker=tracker,
        clock=stamp_clock(camera.clock, config.camera.stamp_offset_s),
        outputs=outputs,
        camera=camera,
        method=config.odometry.method,
        control=Control(tracker, camera),
        loops=loops,
    )


@dataclass
class Surroundings:
    """What the loop works with, beside the camera.

    outputs                    where everything goes
    inbox                      commands for the loop
    recorder, mapper, viewers  those of the outputs that can be told something
    others                     who else may have a complaint for the status
    on_commands                gets its table of the configuration when it has changed
    """

    outputs: Sequence[Output]
    inbox: Inbox[Command] = field(default_factory=Inbox)
    recorder: Recorder = field(default_factory=NoRecorder)
    mapper: Mapper = field(default_factory=NoMapper)
    viewers: Sequence[Viewer] = ()
    others: Sequence[Troubled] = ()
    on_commands: Callable[[CommandSettings], None] = lambda _: None


@dataclass(frozen=True)
class LiveService:
    """The loop, and how a configuration that was read again gets into it.

    appliers  how each key that may change while it runs is applied, on the loop's thread
    """

    service: Service
    appliers: Appliers

    def reconfigure(self, changes: Changes) -> Reconfigure:
        """The command that applies what has changed."""
        return Reconfigure(lambda: apply_changes(changes, self.appliers))


def live_service(config: Config, camera: RgbdCamera, around: Surroundings) -> LiveService:
    """The service for a camera that may come and go."""
    stages = StageClock()
    odometry = make_odometry(config.odometry, stages)
    tracker = PoseTracker(config.T_base_camera.T_base_camera)
    governor = AdjustableGovernor(around.viewers, odometry)
    governor.configure(config.load, config.odometry.feature_count)
    service = Service(
        feed=PersistentFeed(camera),
        odometry=around.mapper.loops.around(odometry),
        stages=stages,
        tracker=tracker,
        clock=stamp_clock(camera.clock, config.camera.stamp_offset_s),
        outputs=around.outputs,
        camera=camera,
        method=config.odometry.method,
        control=Control(tracker, camera, around.inbox, around.recorder, around.mapper),
        governor=governor,
        others=around.others,
        loops=around.mapper.loops,
    )
    return LiveService(service, appliers(camera, governor, around))


def appliers(camera: RgbdCamera, governor: AdjustableGovernor, around: Surroundings) -> Appliers:
    """How each key that may change while the service runs is applied, on the loop's thread."""

    def load(config: Config) -> None:
        governor.configure(config.load, config.odometry.feature_count)

    def tilt(config: Config) -> None:
        if config.sensor.tilt_deg is not None:
            camera.set_tilt_deg(config.sensor.tilt_deg)

    def recorder(config: Config) -> None:
        around.recorder.configure(config.recorder)

    def mapper(config: Config) -> None:
        around.mapper.configure(config.map)

    return {
        "sensor.led": lambda config: camera.set_led(config.sensor.led),
        "sensor.tilt_deg": tilt,
        "odometry.feature_count": load,
        "load.adapt": load,
        "load.min_features": load,
        "commands.per_second": lambda config: around.on_commands(config.commands),
        "recorder.save_on_loss": recorder,
        "recorder.total_mb": recorder,
        "map.max_mb": mapper,
        "map.voxel_m": mapper,
        "map.making_mb": mapper,
        "map.total_mb": mapper,
        "log.level": lambda config: set_level(config.log.level),
    }


def apply_changes(changes: Changes, appliers: Appliers) -> None:
    """Call each applier that is concerned, once; what a camera says to it is logged."""
    for apply in dict.fromkeys(appliers[key] for key in changes.live):
        try:
            apply(changes.config)
        except CameraError as error:
            logger.warning("%s", error)
