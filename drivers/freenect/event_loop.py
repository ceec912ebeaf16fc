"""The only thread that calls libfreenect, from opening the device to closing it."""

import ctypes
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass

from drivers.freenect.context import FreenectContext, RawFrameCallback
from drivers.freenect.device_source import DeviceCalibration, DeviceSource
from drivers.freenect.error_messages import device_hung_error
from drivers.freenect.libfreenect_log import LibfreenectLog
from drivers.freenect.library import DepthFormat, TimeValue

EVENTS_TIMEOUT = TimeValue(0, 20_000)
# Longer than a supervisor waits before it kills the process.
START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 1.5


@dataclass(frozen=True)
class StartedDevice:
    """The properties of a device whose streams run."""

    serial: str
    calibration: DeviceCalibration


@dataclass(frozen=True)
class StreamCallbacks:
    """Called on libfreenect's thread with each image, and with the exception that ends them."""

    on_color: RawFrameCallback
    on_depth: RawFrameCallback
    on_end: Callable[[Exception], None]


class FreenectEventLoop:
    """Runs libfreenect in a thread until it is stopped or the device is gone.

    libfreenect may hang and cannot be interrupted, so every wait has a timeout, and a thread that
    hangs is abandoned.
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
        """Open the device and start both streams.

        Raises:
            CameraError: If that fails.
        """
        self._thread = threading.Thread(
            target=self._run, args=(callbacks,), name="freenect", daemon=True
        )
        self._thread.start()
        try:
            return self._started.result(START_TIMEOUT_S)
        except TimeoutError as error:
            raise device_hung_error() from error

    def stop(self) -> None:
        """Close the device; wait at most `STOP_TIMEOUT_S`."""
        self._is_stopped = True
        self.join(STOP_TIMEOUT_S)

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread to end; return False if it still runs."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self, callbacks: StreamCallbacks) -> None:
        """Body of the thread. An exception reaches `start`, or later `on_end`."""
        try:
            with (
                closing(FreenectContext(self._library, self._log)) as context,
                self._source.open(context) as device,
            ):
                device.start(self._depth_format, callbacks.on_color, callbacks.on_depth)
                calibration = self._source.configure(device)
                self._started.set_result(StartedDevice(device.serial, calibration))
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
