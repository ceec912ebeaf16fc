"""The loop over a camera by script, and what its output received."""

import threading
from collections.abc import Sequence

from tests.vo_service.fakes import (
    CollectingOutput,
    Event,
    FakeClock,
    ScriptedCamera,
    ScriptedOdometry,
)
from vo_service.control import CommandQueue, Control
from vo_service.frame_source import FrameSource, PublishClock, RecordedClock
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.service import OdometryMethod, Service, ServiceInput, ServiceOutputs
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import DeferredWork
from vo_service.types.outputs import LoopClosure, NullLoopClosure, Output


def make_service(
    feed: FrameSource,
    outputs: Sequence[Output],
    estimates: Sequence[Estimate] = (),
    stamps: PublishClock | None = None,
    camera: ScriptedCamera | None = None,
    inbox: CommandQueue | None = None,
    odometry: ScriptedOdometry | None = None,
    loops: LoopClosure | None = None,
    method: str = "surf",
    deferred: DeferredWork | None = None,
) -> Service:
    camera, tracker = camera or ScriptedCamera(), OdomFrame()
    return Service(
        ServiceInput(camera, feed, stamps or RecordedClock()),
        OdometryMethod(
            method,
            odometry or ScriptedOdometry(*estimates),
            CpuStageTimer(),
            deferred or DeferredWork(),
        ),
        tracker,
        Control(tracker, camera, inbox),
        ServiceOutputs(outputs),
        loop_closure=loops or NullLoopClosure(),
    )


def run_loop(
    events: Sequence[Event],
    estimates: Sequence[Estimate] = (),
    clock: FakeClock | None = None,
    stamps: PublishClock | None = None,
) -> CollectingOutput:
    """Run the loop over one pass of a camera."""
    camera, collector = ScriptedCamera(events, clock=clock), CollectingOutput()
    with camera:
        make_service(FrameSource(camera), [collector], estimates, stamps).run(threading.Event())
    return collector
