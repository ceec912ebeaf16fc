"""What can go wrong with a Kinect while the service runs: how it comes, what is said, how it goes.

The tests let each of them happen; the benchmark measures how long the service needs.
"""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from tests.stand_ins.played_kinect import PlayedKinect, Stream
from tests.vo_service.played_service import PlayedService
from tests.waiting import wait_until

GONE = "no Kinect on the USB"
TOLD_S, BACK_S = 2.0, 3.0
HUNG_S, BACK_AFTER_KILL_S = 5.0, 5.0

Action = Callable[[PlayedKinect, PlayedService], None]


@dataclass(frozen=True)
class ServiceFault:
    """One fault.

    words   in the status's reason while it lasts
    told_s  how soon the status is to say so
    back_s  how soon after its end there are to be poses again
    """

    name: str
    begin: Action
    words: str
    end: Action
    told_s: float = TOLD_S
    back_s: float = BACK_S


@dataclass(frozen=True)
class Passed:
    """How a fault went: seconds until it was said, and from its end until there were poses."""

    told_s: float
    back_s: float


def pass_through(
    fault: ServiceFault,
    kinect: PlayedKinect,
    service: PlayedService,
    while_it_lasts: Callable[[], object] = lambda: None,
) -> Passed:
    """Let it begin while the Kinect streams, wait until it is said, let it end, wait for poses."""
    service.until_streaming(time.monotonic())
    before_s = time.monotonic()
    fault.begin(kinect, service)
    begin_s = time.monotonic()
    told_s = service.until_said(fault.words, before_s)
    # What ends by itself (a driver that died is started again) began to end when it began.
    if fault.end is by_itself:
        return Passed(told_s - begin_s, service.until_streaming(told_s) - begin_s)
    while_it_lasts()
    end_s = time.monotonic()
    fault.end(kinect, service)
    return Passed(told_s - begin_s, service.until_streaming(end_s) - end_s)


def by_itself(kinect: PlayedKinect, service: PlayedService) -> None:
    """Nothing needs to be done."""


def _replug_with(fault: Callable[[PlayedKinect, bool], None]) -> Action:
    """What is there when it is plugged in: a running stream would not notice."""

    def begin(kinect: PlayedKinect, service: PlayedService) -> None:
        kinect.unplug()
        fault(kinect, True)
        kinect.plug()

    return begin


def _hang(kinect: PlayedKinect, service: PlayedService) -> None:
    """Plugged in, it answers nothing; returns once it has been opened."""
    kinect.unplug()
    service.until_said(GONE, time.monotonic())
    kinect.freeze_control(True)
    kinect.plug()
    wait_until(lambda: kinect.open_handles > 0, "the Kinect to be opened")


def _lose(every: int) -> Action:
    def begin(kinect: PlayedKinect, service: PlayedService) -> None:
        for stream in Stream:
            kinect.lose_packets(stream, every)

    return begin


FAULTS = (
    ServiceFault(
        "unplug",
        lambda kinect, _: kinect.unplug(),
        GONE,
        lambda kinect, _: kinect.plug(),
    ),
    ServiceFault(
        "stall",
        lambda kinect, _: kinect.stall(True),
        "image for 1 s",
        lambda kinect, _: kinect.stall(False),
    ),
    ServiceFault(
        "busy",
        _replug_with(PlayedKinect.busy),
        "held by another program or the kernel (Failed to claim camera interface",
        lambda kinect, _: kinect.busy(False),
    ),
    ServiceFault(
        "no permission",
        _replug_with(PlayedKinect.forbid),
        "this user may not open it",
        lambda kinect, _: kinect.forbid(False),
    ),
    ServiceFault(
        "no bandwidth",
        lambda kinect, _: kinect.starve(True),
        "no USB bandwidth",
        lambda kinect, _: kinect.starve(False),
    ),
    ServiceFault(
        "all frames torn",
        _lose(every=20),
        "losing USB packets",
        _lose(every=0),
    ),
    ServiceFault(
        "hang while opening",
        _hang,
        "hung while opening the camera",
        lambda kinect, _: kinect.freeze_control(False),
        told_s=HUNG_S,
        back_s=BACK_AFTER_KILL_S,
    ),
    ServiceFault(
        "driver killed",
        lambda _, service: os.kill(service.driver, signal.SIGKILL),
        "the driver crashed (signal 9",
        by_itself,
        back_s=BACK_AFTER_KILL_S,
    ),
    ServiceFault(
        "driver stopped",
        lambda _, service: os.kill(service.driver, signal.SIGSTOP),
        "hung while reading frames",
        by_itself,
        back_s=BACK_AFTER_KILL_S,
    ),
)
