"""Opening the outputs that were asked for, so that a failure closes those already open."""

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from drivers.camera import Pace
from vo_service.load.governor import Viewer
from vo_service.mapping.live.contract import Mapper, NoMapper
from vo_service.outputs.output import Output, TruthSource, no_truth
from vo_service.outputs.trajectory_output import TrajectoryOutput
from vo_service.outputs.worker import DropOldest, HandOver, Wait
from vo_service.outputs.zenoh_opening import OpenAtOnce, WayToOpen
from vo_service.outputs.zenoh_output import LIVE, LOCKSTEP, Extras, ZenohOutput
from vo_service.outputs.zenoh_session import ZenohConfig
from vo_service.recorder.contract import NoRecorder, Recorder
from vo_service.settings import RerunSettings
from vo_service.viewer.output import open_viewer
from vo_service.viewer.targets import check_places

# Lines of the trajectory that a robot's disk may owe: five minutes.
LONGEST_HANG = 9000

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
