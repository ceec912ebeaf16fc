"""Functions of worker processes that do what the name says."""

import ctypes
import logging
import os
import signal
import time

from drivers.core.process.messages import Heartbeat
from drivers.core.process.service_connection import ServiceConnection

PERIOD_S = 0.05


def crash_at_start(service: ServiceConnection) -> None:
    """Crash before the first message."""
    os.kill(os.getpid(), signal.SIGSEGV)


def crash_later(service: ServiceConnection) -> None:
    """Crash while the service takes it for healthy."""
    service.send(Heartbeat())
    os.kill(os.getpid(), signal.SIGSEGV)


def hang(service: ServiceConnection) -> None:
    """Hang in native code that holds the GIL."""
    service.send(Heartbeat())
    ctypes.PyDLL(None).sleep(3600)


def flood(service: ServiceConnection) -> None:
    """Send messages as fast as possible, and read none."""
    while service.send(Heartbeat()):
        logging.getLogger("flood").debug("one more")


def refuse_to_end(service: ServiceConnection) -> None:
    """Work on, whatever the service asks."""
    while True:
        service.send(Heartbeat())
        time.sleep(PERIOD_S)  # its own pace


def work(service: ServiceConnection) -> None:
    """Work until the service asks the process to end."""
    service.send(Heartbeat())
    for _ in service.messages(idle_s=PERIOD_S):
        service.send(Heartbeat())
