"""A capture session: from opening the device to closing it, with pairs of images."""

import ctypes
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass

from drivers.camera import CameraCounters, FrameTimeout
from drivers.core import CameraLostError
from drivers.freenect.bindings import TimeValue
from drivers.freenect.context import (
    BufferPool,
    FrameCallback,
    FreenectContext,
    ImagePair,
    PooledImage,
    RawFrameCallback,
)
from drivers.freenect.errors import (
    device_hung_error,
    stream_not_started_error,
    stream_stalled_error,
)
from drivers.freenect.log import LibfreenectLog, StreamHealth
from drivers.freenect.sources import DeviceCalibration, DeviceSource, StreamTimeouts
from drivers.time_sync import NearestFramePairing, StampUnwrapper

EVENTS_TIMEOUT = TimeValue(0, 20_000)
# Longer than a supervisor waits before it kills the process.
START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 1.5
TICKS_PER_SECOND, STAMP_BITS = 60e6, 32


class StreamWatchdog:
    """Checks the activity of named streams that were started at `started_s` (CLOCK_MONOTONIC)."""

    def __init__(
        self, streams: Mapping[str, StreamHealth], timeouts: StreamTimeouts, started_s: float
    ) -> None:
        self._streams, self._timeouts, self._started_s = streams, timeouts, started_s

    @property
    def due_s(self) -> float:
        """The earliest time at which `check` can fail."""
        return min(self._due_s(stream) for stream in self._streams.values())

    def check(self, now_s: float) -> None:
        """Raise CameraLostError if a stream has been silent for too long."""
        for name, stream in self._streams.items():
            if now_s < self._due_s(stream):
                continue
            if stream.last_activity_s:
                raise stream_stalled_error(name, self._timeouts.next_image_s)
            raise stream_not_started_error(name, self._timeouts.first_image_s)

    def _due_s(self, stream: StreamHealth) -> float:
        if stream.last_activity_s:
            return stream.last_activity_s + self._timeouts.next_image_s
        return self._started_s + self._timeouts.first_image_s


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
        self,
        library: ctypes.CDLL,
        source: DeviceSource,
        log: LibfreenectLog,
        *,
        registers_depth: bool,
    ) -> None:
        self._library, self._source, self._log = library, source, log
        self._registers_depth = registers_depth
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
                source = self._source
                device.start(
                    source.color_format,
                    source.depth_format,
                    callbacks.on_color,
                    callbacks.on_depth,
                )
                calibration = source.configure(device, registers_depth=self._registers_depth)
                self._started.set_result(StartedDevice(device.serial, calibration))
                self._process_events(context)
        except Exception as error:
            if self._started.done():
                callbacks.on_end(error)
            else:
                self._started.set_exception(error)

    def _process_events(self, context: FreenectContext) -> None:
        process_events = context.make_event_processor(EVENTS_TIMEOUT)
        while not self._is_stopped:
            if not process_events():
                raise self._source.make_end_exception()


def _not_open_error() -> CameraLostError:
    return CameraLostError("the camera is not open; open it first")


class NullSession:
    """The session before the first `open`."""

    counters = CameraCounters()
    incomplete_images = (0, 0)

    def get(self, timeout_s: float) -> ImagePair:
        """Raise CameraLostError."""
        raise _not_open_error()

    def stop(self) -> None:
        pass

    def wait_until_ended(self, timeout_s: float) -> bool:
        return True


class CaptureSession:
    """One use of the device, which ends with `stop`. The next one has new clocks."""

    def __init__(
        self,
        library: ctypes.CDLL,
        source: DeviceSource,
        earlier_counters: CameraCounters,
        *,
        registers_depth: bool,
    ) -> None:
        self._earlier_counters = earlier_counters
        self._log = LibfreenectLog()
        self._pairing: NearestFramePairing[PooledImage, PooledImage] = NearestFramePairing(
            min_period_s=source.min_period_s
        )
        self._source, self._queue = source, source.make_queue()
        self._timeouts = source.timeouts
        self._watchdog = self._make_watchdog()
        self._loop = FreenectEventLoop(library, source, self._log, registers_depth=registers_depth)

    def start(self) -> StartedDevice:
        """Open the device and start its streams. Raises CameraError."""
        started = self._loop.start(self._make_callbacks())
        self._watchdog = self._make_watchdog()
        return started

    def get(self, timeout_s: float) -> ImagePair:
        """Wait for a pair. Raises FrameTimeout, EndOfStream, CameraLostError."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            until_s = min(deadline_s, self._watchdog.due_s)
            try:
                return self._queue.get(max(0.0, until_s - time.monotonic()))
            except TimeoutError:
                self._watchdog.check(time.monotonic())
                if time.monotonic() >= deadline_s:
                    raise FrameTimeout from None

    def stop(self) -> None:
        """Close the device. The counters remain valid."""
        self._queue.abort(_not_open_error())
        self._loop.stop()

    def wait_until_ended(self, timeout_s: float) -> bool:
        """Wait until libfreenect has released the device; return False if it hangs."""
        return self._loop.join(timeout_s)

    @property
    def counters(self) -> CameraCounters:
        """Totals of this session and of those before."""
        log, queue = self._log, self._queue
        return self._earlier_counters + CameraCounters(
            delivered=queue.delivered,
            dropped=queue.dropped,
            skipped=log.depth.incomplete + self._pairing.unpaired,
            lost_packets=log.color.lost_packets + log.depth.lost_packets,
        )

    @property
    def incomplete_images(self) -> tuple[int, int]:
        """Incomplete images and all images of the last second, of both streams together."""
        now_s = time.monotonic()
        incomplete_color, colors = self._log.color.count_recent(now_s)
        incomplete_depth, depths = self._log.depth.count_recent(now_s)
        return incomplete_color + incomplete_depth, colors + depths

    def _make_watchdog(self) -> StreamWatchdog:
        streams = {"color": self._log.color, "depth": self._log.depth}
        return StreamWatchdog(streams, self._timeouts, time.monotonic())

    def _make_callbacks(self) -> StreamCallbacks:
        """Make the callbacks. Only the thread holds them, so their buffers are freed with it."""
        clock = StampUnwrapper(TICKS_PER_SECOND, STAMP_BITS)
        color, depth = BufferPool(self._source.color_format), BufferPool(self._source.depth_format)
        return StreamCallbacks(
            FrameCallback(color, clock, self._log.color, self._add_color).handle_frame,
            FrameCallback(depth, clock, self._log.depth, self._add_depth).handle_frame,
            self._finish,
        )

    # libfreenect's thread calls these.

    def _add_color(self, device_s: float, image: PooledImage) -> None:
        self._put_pairs(self._pairing.add_color(device_s, image))

    def _add_depth(self, device_s: float, image: PooledImage) -> None:
        self._put_pairs(self._pairing.add_depth(device_s, image))

    def _put_pairs(self, pairs: list[ImagePair]) -> None:
        for pair in pairs:
            self._queue.put(pair)

    def _finish(self, exception: Exception) -> None:
        self._put_pairs(self._pairing.finish())
        self._queue.finish(exception)
