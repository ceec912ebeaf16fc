"""The loop over a camera by script, and what its output heard."""

import threading
from collections.abc import Sequence

from tests.vo_service.fakes import (
    Collector,
    Event,
    FakeClock,
    ScriptedCamera,
    ScriptedOdometry,
)
from vo_service.control.control import Control
from vo_service.control.inbox import Inbox
from vo_service.feed import Feed, PlainFeed
from vo_service.pose_tracker import PoseTracker
from vo_service.service import Service
from vo_service.stage_clock import StageClock
from vo_service.stamps import RecordedClock, StampClock
from vo_service.types import Command, Estimate, Loops, NoLoops, Output


def make_service(
    feed: Feed,
    outputs: Sequence[Output],
    estimates: Sequence[Estimate] = (),
    stamps: StampClock | None = None,
    camera: ScriptedCamera | None = None,
    inbox: Inbox[Command] | None = None,
    odometry: ScriptedOdometry | None = None,
    loops: Loops | None = None,
    method: str = "surf",
) -> Service:
    camera, tracker = camera or ScriptedCamera(), PoseTracker()
    return Service(
        feed=feed,
        odometry=odometry or ScriptedOdometry(*estimates),
        stages=StageClock(),
        tracker=tracker,
        clock=stamps or RecordedClock(),
        outputs=outputs,
        camera=camera,
        method=method,
        control=Control(tracker, camera, inbox),
        loops=loops or NoLoops(),
    )


def play(
    events: Sequence[Event],
    estimates: Sequence[Estimate] = (),
    clock: FakeClock | None = None,
    stamps: StampClock | None = None,
) -> Collector:
    """Run the loop over one pass of a camera."""
    camera, collector = ScriptedCamera(events, clock=clock), Collector()
    with camera:
        make_service(PlainFeed(camera), [collector], estimates, stamps).run(threading.Event())
    return collector
