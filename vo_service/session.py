"""One run from start to end: put the parts together and run the loop."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import cv2

from drivers.camera import RgbdCamera
from drivers.errors import UserFacingError
from drivers.jit import interruptible
from drivers.memory import release_memory
from vo_service.config import Config, make_odometry
from vo_service.control.control import Control
from vo_service.feed import Feed
from vo_service.folders import cache_folder
from vo_service.interrupts import Stop
from vo_service.mapping.loops.contract import Loops, NoLoops
from vo_service.outputs.output import Output
from vo_service.pose_tracker import PoseTracker
from vo_service.service import Service
from vo_service.stage_clock import StageClock
from vo_service.stamps import stamp_clock
from vo_service.statistics import Statistics
from vo_service.terminal import Terminal
from vo_service.warm_up import warm_up

T = TypeVar("T")


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


def prepare_kernels(config: Config, terminal: Terminal, stop: Stop) -> float:
    """Compile or load the method's kernels, as `prepared` does; returns the seconds it took."""
    return prepared(partial(warm_up, config.odometry.method), terminal, stop)


def prepare_loops(terminal: Terminal, stop: Stop) -> float:
    """The same for what knows places again."""
    from vo_service.mapping.loops.warm_up import warm_up_loops

    return prepared(warm_up_loops, terminal, stop)


def prepared(work: Callable[[Callable[[str], None]], T], terminal: Terminal, stop: Stop) -> T:
    """Do what compiles or loads kernels, with progress: `work` gets whom to tell its stages.

    Raises KeyboardInterrupt, between two kernels, when asked to stop; UserFacingError if what was
    compiled cannot be kept.
    """
    # One thread: the service's latency must not depend on who else needs the other core.
    cv2.setNumThreads(1)
    label = "preparing the numeric kernels (longer the first time)"
    with interruptible(stop.check), terminal.busy(label) as busy:
        try:
            result = work(busy.detail)
        except OSError as error:
            raise UserFacingError(
                f"{cache_folder()}: the compiled kernels cannot be kept: {error.strerror}; free "
                "some space, or name a folder elsewhere in XDG_CACHE_HOME"
            ) from error
        stop.check()
    return result


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
