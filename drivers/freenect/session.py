"""One time that the device is open: from its callbacks to pairs of images."""

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
    """Before the first one."""

    counters = CameraCounters()
    incomplete_images = (0, 0)

    def get(self, timeout_s: float) -> ImagePair:
        """Raises MailboxClosedError."""
        raise FrameQueueClosedError

    def stop(self) -> None:
        """See `CaptureSession`."""

    def wait_until_ended(self, timeout_s: float) -> bool:
        """See `CaptureSession`."""
        return True


class CaptureSession:
    """Not open again after `stop`: libfreenect, clocks and counts begin anew with the next one."""

    def __init__(self, library: ctypes.CDLL, source: DeviceSource, depth: DepthFormat) -> None:
        self._log = LibfreenectLog()
        self._pairing: NearestFramePairing[PooledImage, PooledImage] = NearestFramePairing(
            min_period_s=source.min_period_s
        )
        self._queue = source.make_queue()
        self._timeouts = source.timeouts
        self._watchdog = self._make_watchdog()
        self._loop = FreenectEventLoop(library, source, depth, self._log)

    def start(self) -> StartedDevice:
        """Raises CameraError."""
        started = self._loop.start(self._make_callbacks())
        self._watchdog = self._make_watchdog()
        return started

    def get(self, timeout_s: float) -> ImagePair:
        """Wait for a pair. Raises NoFrameYet, EndOfStream, CameraLostError."""
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
        """Close the device. What was counted can still be asked for."""
        self._queue.close()
        self._loop.stop()

    def wait_until_ended(self, timeout_s: float) -> bool:
        """Wait until libfreenect has let go of the device; False if it hangs."""
        return self._loop.join(timeout_s)

    @property
    def counters(self) -> CameraCounters:
        """Totals of this session."""
        log, mailbox = self._log, self._queue
        return CameraCounters(
            delivered=mailbox.delivered,
            dropped=mailbox.dropped,
            skipped=log.depth.incomplete + self._pairing.unpaired,
            lost_packets=log.color.lost_packets + log.depth.lost_packets,
        )

    @property
    def incomplete_images(self) -> tuple[int, int]:
        """Torn images and all images of the last second, both streams together."""
        now_s = time.monotonic()
        (torn, images), (torn_depth, depths) = (
            stream.count_recent(now_s) for stream in (self._log.color, self._log.depth)
        )
        return torn + torn_depth, images + depths

    def _make_watchdog(self) -> StreamWatchdog:
        streams = {"color": self._log.color, "depth": self._log.depth}
        return StreamWatchdog(streams, self._timeouts, time.monotonic())

    def _make_callbacks(self) -> StreamCallbacks:
        """For the thread alone: kept here, they and their slots would be gone only much later."""
        clock = StampUnwrapper(TICKS_PER_SECOND, STAMP_BITS)
        color, depth = BufferPool((480, 640, 3), np.uint8), BufferPool((480, 640), np.uint16)
        return StreamCallbacks(
            FrameCallback(color, clock, self._log.color, self._add_color).handle_frame,
            FrameCallback(depth, clock, self._log.depth, self._add_depth).handle_frame,
            self._finish,
        )

    # The thread that runs libfreenect calls these.

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
