"""The one thread that calls libfreenect: from opening the device to closing it."""

import ctypes
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass

from drivers.freenect.context import FreenectContext, RawFrameCallback
from drivers.freenect.device_source import DeviceSource
from drivers.freenect.error_messages import device_hung_error
from drivers.freenect.libfreenect_log import LibfreenectLog
from drivers.freenect.library import DepthFormat, TimeValue
from drivers.freenect.valid_depth import DepthFilter

EVENTS_TIMEOUT = TimeValue(0, 20_000)
# Longer than a supervisor that can kill the process waits.
START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 1.5


@dataclass(frozen=True)
class StartedDevice:
    """What is known once both streams run."""

    serial: str
    depth_filter: DepthFilter


@dataclass(frozen=True)
class StreamCallbacks:
    """Who gets the images, and why there are no more."""

    on_color: RawFrameCallback
    on_depth: RawFrameCallback
    on_end: Callable[[Exception], None]


class FreenectEventLoop:
    """Runs libfreenect in a thread until it is stopped or the device ends.

    libfreenect may hang, and cannot be interrupted then: waiting for it has limits, and a thread
    that hangs is left behind.
    """

    def __init__(
        self, library: ctypes.CDLL, source: DeviceSource, depth: DepthFormat, log: LibfreenectLog
    ) -> None:
        self._library, self._source, self._log = library, source, log
        self._depth_format = source.depth_format(depth)
        self._is_stopped = False
        self._started: Future[StartedDevice] = Future()
        self._thread = threading.Thread()

    def start(self, callbacks: StreamCallbacks) -> StartedDevice:
        """Open the device and start both streams. Raises CameraError."""
        self._thread = threading.Thread(
            target=self._run, args=(callbacks,), name="freenect", daemon=True
        )
        self._thread.start()
        try:
            return self._started.result(START_TIMEOUT_S)
        except TimeoutError as error:
            raise device_hung_error() from error

    def stop(self) -> None:
        """Have the device closed, and wait for that, but not for ever."""
        self._is_stopped = True
        self.join(STOP_TIMEOUT_S)

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread to end; False if it is still there."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self, callbacks: StreamCallbacks) -> None:
        """Body of the thread. What goes wrong reaches `start`, or later the taker of the end."""
        try:
            with (
                closing(FreenectContext(self._library, self._log)) as context,
                self._source.open(context) as device,
            ):
                device.start(self._depth_format, callbacks.on_color, callbacks.on_depth)
                measured = self._source.configure(device)
                self._started.set_result(StartedDevice(device.serial, measured))
                self._process_events(context)
        except Exception as error:
            if self._started.done():
                callbacks.on_end(error)
            else:
                self._started.set_exception(error)

    def _process_events(self, context: FreenectContext) -> None:
        while not self._is_stopped:
            if not context.process_events(EVENTS_TIMEOUT):
                raise self._source.make_end_exception()
