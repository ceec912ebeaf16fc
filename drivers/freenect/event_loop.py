"""The one thread that calls libfreenect: from opening the device to closing it."""

import ctypes
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass

from drivers.freenect.context import Context, FrameTaker
from drivers.freenect.depth import DepthFilter
from drivers.freenect.faults import hangs
from drivers.freenect.library import DepthFormat, TimeValue
from drivers.freenect.log import Log
from drivers.freenect.source import Source

EVENTS_TIMEOUT = TimeValue(0, 20_000)
# Longer than a supervisor that can kill the process waits.
START_LIMIT_S = 10.0
STOP_LIMIT_S = 1.5


@dataclass(frozen=True)
class Started:
    """What is known once both streams run."""

    serial: str
    measured: DepthFilter


@dataclass(frozen=True)
class Takers:
    """Who gets the images, and why there are no more."""

    colour: FrameTaker
    depth: FrameTaker
    end: Callable[[Exception], None]


class EventLoop:
    """Runs libfreenect in a thread until it is stopped or the device ends.

    libfreenect may hang, and cannot be interrupted then: waiting for it has limits, and a thread
    that hangs is left behind.
    """

    def __init__(self, library: ctypes.CDLL, source: Source, depth: DepthFormat, log: Log) -> None:
        self._library, self._source, self._log = library, source, log
        self._depth_format = source.depth_format(depth)
        self._is_stopped = False
        self._started: Future[Started] = Future()
        self._thread = threading.Thread()

    def start(self, takers: Takers) -> Started:
        """Open the device and start both streams. Raises CameraError."""
        self._thread = threading.Thread(
            target=self._run, args=(takers,), name="freenect", daemon=True
        )
        self._thread.start()
        try:
            return self._started.result(START_LIMIT_S)
        except TimeoutError as error:
            raise hangs() from error

    def stop(self) -> None:
        """Have the device closed, and wait for that, but not for ever."""
        self._is_stopped = True
        self.join(STOP_LIMIT_S)

    def join(self, limit_s: float) -> bool:
        """Wait for the thread to end; False if it is still there."""
        if self._thread.is_alive():
            self._thread.join(limit_s)
        return not self._thread.is_alive()

    def _run(self, takers: Takers) -> None:
        """Body of the thread. What goes wrong reaches `start`, or later the taker of the end."""
        try:
            with (
                closing(Context(self._library, self._log)) as context,
                self._source.open(context) as device,
            ):
                device.start(self._depth_format, takers.colour, takers.depth)
                measured = self._source.set_up(device)
                self._started.set_result(Started(device.serial, measured))
                self._work(context)
        except Exception as error:
            if self._started.done():
                takers.end(error)
            else:
                self._started.set_exception(error)

    def _work(self, context: Context) -> None:
        while not self._is_stopped:
            if not context.process_events(EVENTS_TIMEOUT):
                raise self._source.end()
