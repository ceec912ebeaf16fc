"""The service on a robot: the loop of a replay, with commands, adaptation and reconfiguration."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from drivers.camera import RgbdCamera
from vo_service.config import Config, make_odometry
from vo_service.control.control import Control, Order
from vo_service.control.inbox import Inbox
from vo_service.control.reconfigure import Appliers
from vo_service.feed import PersistentFeed
from vo_service.load.adjustable import AdjustableGovernor
from vo_service.load.governor import Viewer
from vo_service.logs import set_level
from vo_service.mapping.live.contract import Mapper, NoMapper
from vo_service.outputs.output import Output, Troubled
from vo_service.pose_tracker import PoseTracker
from vo_service.recorder.contract import NoRecorder, Recorder
from vo_service.service import Service
from vo_service.settings import CommandSettings
from vo_service.stage_clock import StageClock
from vo_service.stamps import stamp_clock


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
    inbox: Inbox[Order] = field(default_factory=Inbox)
    recorder: Recorder = field(default_factory=NoRecorder)
    mapper: Mapper = field(default_factory=NoMapper)
    viewers: Sequence[Viewer] = ()
    others: Sequence[Troubled] = ()
    on_commands: Callable[[CommandSettings], None] = lambda _: None


def live_service(config: Config, camera: RgbdCamera, around: Surroundings) -> Service:
    """The service for a camera that may come and go."""
    stages = StageClock()
    odometry = make_odometry(config.odometry, stages)
    tracker = PoseTracker(config.T_base_camera.T_base_camera)
    governor = AdjustableGovernor(around.viewers, odometry)
    governor.configure(config.load, config.odometry.feature_count)
    live_keys = appliers(camera, governor, around)
    return Service(
        feed=PersistentFeed(camera),
        odometry=around.mapper.loops.around(odometry),
        stages=stages,
        tracker=tracker,
        clock=stamp_clock(camera.clock, config.camera.stamp_offset_s),
        outputs=around.outputs,
        camera=camera,
        method=config.odometry.method,
        control=Control(tracker, camera, around.inbox, around.recorder, live_keys, around.mapper),
        governor=governor,
        others=around.others,
        loops=around.mapper.loops,
    )


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
