"""What can go wrong with a Kinect while the service runs: how it comes, what is said, how it goes.

The tests let each of them happen; the benchmark measures how long the service needs.
"""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from tests.simulators.kinect_simulator import KinectSimulator, KinectStream
from tests.vo_service.service_process import ServiceProcess
from tests.waiting import wait_until

NO_KINECT_REASON = "no Kinect on the USB"
MAX_REPORT_S, MAX_RECOVERY_S = 2.0, 3.0
MAX_HANG_REPORT_S, MAX_RECOVERY_AFTER_KILL_S = 5.0, 5.0

Action = Callable[[KinectSimulator, ServiceProcess], None]


@dataclass(frozen=True)
class SensorFault:
    """One fault.

    words   in the status's reason while it lasts
    told_s  how soon the status is to say so
    back_s  how soon after its end there are to be poses again
    """

    name: str
    begin: Action
    status_text: str
    end: Action
    max_report_s: float = MAX_REPORT_S
    max_recovery_s: float = MAX_RECOVERY_S


@dataclass(frozen=True)
class FaultTiming:
    """How a fault went: seconds until it was said, and from its end until there were poses."""

    report_s: float
    recovery_s: float


def run_fault(
    fault: SensorFault,
    kinect: KinectSimulator,
    service: ServiceProcess,
    while_it_lasts: Callable[[], object] = lambda: None,
) -> FaultTiming:
    """Let it begin while the Kinect streams, wait until it is said, let it end, wait for poses."""
    service.wait_until_streaming(time.monotonic())
    before_s = time.monotonic()
    fault.begin(kinect, service)
    begin_s = time.monotonic()
    reported_s = service.wait_for_reason(fault.status_text, before_s)
    # What ends by itself (a driver that died is started again) began to end when it began.
    if fault.end is do_nothing:
        return FaultTiming(reported_s - begin_s, service.wait_until_streaming(reported_s) - begin_s)
    while_it_lasts()
    end_s = time.monotonic()
    fault.end(kinect, service)
    return FaultTiming(reported_s - begin_s, service.wait_until_streaming(end_s) - end_s)


def do_nothing(kinect: KinectSimulator, service: ServiceProcess) -> None:
    """Nothing needs to be done."""


def _make_replug_action(fault: Callable[[KinectSimulator, bool], None]) -> Action:
    """What is there when it is plugged in: a running stream would not notice."""

    def begin(kinect: KinectSimulator, service: ServiceProcess) -> None:
        kinect.unplug()
        fault(kinect, True)
        kinect.plug()

    return begin


def _freeze_control(kinect: KinectSimulator, service: ServiceProcess) -> None:
    """Plugged in, it answers nothing; returns once it has been opened."""
    kinect.unplug()
    service.wait_for_reason(NO_KINECT_REASON, time.monotonic())
    kinect.freeze_control(True)
    kinect.plug()
    wait_until(lambda: kinect.open_handles > 0, "the Kinect to be opened")


def _make_packet_loss(every: int) -> Action:
    def begin(kinect: KinectSimulator, service: ServiceProcess) -> None:
        for stream in KinectStream:
            kinect.lose_packets(stream, every)

    return begin


SENSOR_FAULTS = (
    SensorFault(
        "unplug",
        lambda kinect, _: kinect.unplug(),
        NO_KINECT_REASON,
        lambda kinect, _: kinect.plug(),
    ),
    SensorFault(
        "stall",
        lambda kinect, _: kinect.stall(True),
        "image for 1 s",
        lambda kinect, _: kinect.stall(False),
    ),
    SensorFault(
        "busy",
        _make_replug_action(KinectSimulator.set_busy),
        "held by another program or the kernel (Failed to claim camera interface",
        lambda kinect, _: kinect.set_busy(False),
    ),
    SensorFault(
        "no permission",
        _make_replug_action(KinectSimulator.deny_access),
        "this user may not open it",
        lambda kinect, _: kinect.deny_access(False),
    ),
    SensorFault(
        "no bandwidth",
        lambda kinect, _: kinect.remove_bandwidth(True),
        "no USB bandwidth",
        lambda kinect, _: kinect.remove_bandwidth(False),
    ),
    SensorFault(
        "all frames incomplete",
        _make_packet_loss(every=20),
        "losing USB packets",
        _make_packet_loss(every=0),
    ),
    SensorFault(
        "hang while opening",
        _freeze_control,
        "hung while opening the camera",
        lambda kinect, _: kinect.freeze_control(False),
        max_report_s=MAX_HANG_REPORT_S,
        max_recovery_s=MAX_RECOVERY_AFTER_KILL_S,
    ),
    SensorFault(
        "driver killed",
        lambda _, service: os.kill(service.driver_pid, signal.SIGKILL),
        "the driver crashed (signal 9",
        do_nothing,
        max_recovery_s=MAX_RECOVERY_AFTER_KILL_S,
    ),
    SensorFault(
        "driver stopped",
        lambda _, service: os.kill(service.driver_pid, signal.SIGSTOP),
        "hung while reading frames",
        do_nothing,
        max_recovery_s=MAX_RECOVERY_AFTER_KILL_S,
    ),
)
