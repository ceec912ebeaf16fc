"""Faults by name and time: ``unplug@5s+3s``, ``lose=50@2s``."""

import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.core import InputError
from tests.simulators.kinect_simulator import KinectSimulator, KinectStream

DEFAULT_LOSS_INTERVAL = 100

_ACTIONS: dict[str, Callable[[KinectSimulator, bool, int], None]] = {
    "unplug": lambda kinect, on, _: kinect.unplug() if on else kinect.plug(),
    "stall": lambda kinect, on, _: kinect.stall(on),
    "stall-depth": lambda kinect, on, _: kinect.stall(on, KinectStream.DEPTH),
    "stall-color": lambda kinect, on, _: kinect.stall(on, KinectStream.COLOR),
    "lose": lambda kinect, on, every: _lose_packets(kinect, every if on else 0),
    "freeze": lambda kinect, on, _: kinect.freeze_control(on),
    "busy": lambda kinect, on, _: kinect.set_busy(on),
    "forbid": lambda kinect, on, _: kinect.deny_access(on),
    "starve": lambda kinect, on, _: kinect.remove_bandwidth(on),
    "slow-bus": lambda kinect, on, _: kinect.set_full_speed_bus(on),
    "kernel-driver": lambda kinect, on, _: kinect.attach_kernel_driver(on),
    "no-firmware": lambda kinect, on, _: kinect.set_firmware_loaded(not on),
}
FAULT_NAMES = tuple(_ACTIONS)
_TIMED = re.compile(
    r"(?P<name>[a-z-]+)(=(?P<number>\d+))?"
    r"(@(?P<start>\d+(\.\d+)?)s?)?(\+(?P<length>\d+(\.\d+)?)s?)?"
)
_TYPED = re.compile(r"(?P<name>[a-z-]+)(=(?P<number>\d+))?(\s+(?P<switch>on|off))?")


def _lose_packets(kinect: KinectSimulator, every: int) -> None:
    for stream in KinectStream:
        kinect.lose_packets(stream, every)


@dataclass(frozen=True)
class TimedFault:
    """A fault from `start_s` on, for `length_s` seconds or without end."""

    name: str
    number: int
    start_s: float
    length_s: float | None

    def switch(self, kinect: KinectSimulator, on: bool) -> None:
        """Start or end the fault."""
        _ACTIONS[self.name](kinect, on, self.number)


def parse_fault(text: str) -> TimedFault:
    """Parse ``NAME[=NUMBER][@START][+LENGTH]``, times in seconds. Raises InputError."""
    match = _TIMED.fullmatch(text)
    if match is None or match["name"] not in _ACTIONS:
        raise InputError(
            f"fault {text!r}: use NAME@START or NAME@START+LENGTH (seconds), with NAME one of: "
            f"{', '.join(FAULT_NAMES)}"
        )
    length_s = float(match["length"]) if match["length"] else None
    number = int(match["number"] or DEFAULT_LOSS_INTERVAL)
    return TimedFault(match["name"], number, float(match["start"] or 0.0), length_s)


def run_command(kinect: KinectSimulator, line: str) -> None:
    """Run a typed line: ``unplug``, ``unplug off``, ``plug``, ``lose=50``. Raises InputError."""
    text = line.strip().replace("_", "-")
    match = _TYPED.fullmatch("unplug off" if text == "plug" else text)
    if match is None or match["name"] not in _ACTIONS:
        raise InputError(f"{text!r}: type one of: plug, {', '.join(FAULT_NAMES)}; ' off' ends one")
    number = int(match["number"] or DEFAULT_LOSS_INTERVAL)
    _ACTIONS[match["name"]](kinect, match["switch"] != "off", number)


def schedule_faults(kinect: KinectSimulator, faults: Iterable[TimedFault]) -> list[threading.Timer]:
    """Start a timer for each fault; faults from second 0 are active when this returns."""
    timers = []
    for fault in faults:
        if fault.start_s == 0.0:
            fault.switch(kinect, True)
        else:
            timers.append(threading.Timer(fault.start_s, fault.switch, (kinect, True)))
        if fault.length_s is not None:
            end_s = fault.start_s + fault.length_s
            timers.append(threading.Timer(end_s, fault.switch, (kinect, False)))
    for timer in timers:
        timer.daemon = True
        timer.start()
    return timers
