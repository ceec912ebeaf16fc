"""A capture session: from opening the device to closing it, with pairs of images."""

import ctypes
import time
from contextlib import suppress

import numpy as np

from drivers.camera import CameraCounters, FrameTimeout
from drivers.freenect.device_source import DeviceSource
from drivers.freenect.event_loop import FreenectEventLoop, StartedDevice, StreamCallbacks
from drivers.freenect.frame_callback import BufferPool, FrameCallback
from drivers.freenect.frame_queue import FrameQueueClosedError, ImagePair, PooledImage
from drivers.freenect.libfreenect_log import LibfreenectLog
from drivers.freenect.library import DepthFormat
from drivers.freenect.watchdog import StreamWatchdog
from drivers.time_sync import NearestFramePairing, StampUnwrapper

TICKS_PER_SECOND, STAMP_BITS = 60e6, 32


class NullSession:
    """The session before the first `open`."""

    counters = CameraCounters()
    incomplete_images = (0, 0)

    def get(self, timeout_s: float) -> ImagePair:
        """Raise FrameQueueClosedError."""
        raise FrameQueueClosedError

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
        depth: DepthFormat,
        earlier_counters: CameraCounters,
    ) -> None:
        self._earlier_counters = earlier_counters
        self._log = LibfreenectLog()
        self._pairing: NearestFramePairing[PooledImage, PooledImage] = NearestFramePairing(
            min_period_s=source.min_period_s
        )
        self._queue = source.make_queue()
        self._timeouts = source.timeouts
        self._watchdog = self._make_watchdog()
        self._loop = FreenectEventLoop(library, source, depth, self._log)

    def start(self) -> StartedDevice:
        """Open the device and start its streams.

        Raises:
            CameraError: If that fails.
        """
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
            except FrameTimeout:
                self._watchdog.check(time.monotonic())
                if time.monotonic() >= deadline_s:
                    raise

    def stop(self) -> None:
        """Close the device. The counters remain valid."""
        self._queue.close()
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
        color, depth = BufferPool((480, 640, 3), np.uint8), BufferPool((480, 640), np.uint16)
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
        with suppress(FrameQueueClosedError):
            self._put_pairs(self._pairing.finish())
        self._queue.finish(exception)
