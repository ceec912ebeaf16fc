"""One time that the device is open: from its callbacks to pairs of images."""

import ctypes
import time
from contextlib import suppress

import numpy as np

from drivers.camera import CameraCounters, NoFrameYet
from drivers.device_clock import DeviceClock
from drivers.freenect.event_loop import EventLoop, Started, Takers
from drivers.freenect.library import DepthFormat
from drivers.freenect.log import Log
from drivers.freenect.mailbox import Image, ImagePair, MailboxClosedError
from drivers.freenect.source import Source
from drivers.freenect.streams import Slots, StreamIntake
from drivers.freenect.watchdog import Watchdog
from drivers.nearest import NearestPairing

TICKS_PER_SECOND, STAMP_BITS = 60e6, 32


class NoSession:
    """Before the first one."""

    counters = CameraCounters()
    torn = (0, 0)

    def take(self, timeout_s: float) -> ImagePair:
        """Raises MailboxClosedError."""
        raise MailboxClosedError

    def stop(self) -> None:
        """See `Session`."""

    def has_ended(self, limit_s: float) -> bool:
        """See `Session`."""
        return True


class Session:
    """Not open again after `stop`: libfreenect, clocks and counts begin anew with the next one."""

    def __init__(self, library: ctypes.CDLL, source: Source, depth: DepthFormat) -> None:
        self._log = Log()
        self._pairing: NearestPairing[Image, Image] = NearestPairing(
            shortest_period_s=source.shortest_period_s
        )
        self._mailbox = source.mailbox()
        self._patience = source.patience
        self._watchdog = self._watch()
        self._loop = EventLoop(library, source, depth, self._log)

    def start(self) -> Started:
        """Raises CameraError."""
        started = self._loop.start(self._takers())
        self._watchdog = self._watch()
        return started

    def take(self, timeout_s: float) -> ImagePair:
        """Wait for a pair. Raises NoFrameYet, EndOfStream, CameraLostError."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            until_s = min(deadline_s, self._watchdog.due_s)
            try:
                return self._mailbox.take(max(0.0, until_s - time.monotonic()))
            except NoFrameYet:
                self._watchdog.check(time.monotonic())
                if time.monotonic() >= deadline_s:
                    raise

    def stop(self) -> None:
        """Close the device. What was counted can still be asked for."""
        self._mailbox.close()
        self._loop.stop()

    def has_ended(self, limit_s: float) -> bool:
        """Wait until libfreenect has let go of the device; False if it hangs."""
        return self._loop.join(limit_s)

    @property
    def counters(self) -> CameraCounters:
        """Totals of this session."""
        log, mailbox = self._log, self._mailbox
        return CameraCounters(
            delivered=mailbox.delivered,
            dropped=mailbox.dropped,
            skipped=log.depth.torn + self._pairing.unpaired,
            lost_packets=log.colour.lost_packets + log.depth.lost_packets,
        )

    @property
    def torn(self) -> tuple[int, int]:
        """Torn images and all images of the last second, both streams together."""
        now_s = time.monotonic()
        (torn, images), (torn_depth, depths) = (
            stream.recent(now_s) for stream in (self._log.colour, self._log.depth)
        )
        return torn + torn_depth, images + depths

    def _watch(self) -> Watchdog:
        streams = {"colour": self._log.colour, "depth": self._log.depth}
        return Watchdog(streams, self._patience, time.monotonic())

    def _takers(self) -> Takers:
        """For the thread alone: kept here, they and their slots would be gone only much later."""
        clock = DeviceClock(TICKS_PER_SECOND, STAMP_BITS)
        colour, depth = Slots((480, 640, 3), np.uint8), Slots((480, 640), np.uint16)
        return Takers(
            StreamIntake(colour, clock, self._log.colour, self._add_colour).take,
            StreamIntake(depth, clock, self._log.depth, self._add_depth).take,
            self._end,
        )

    # The thread that runs libfreenect calls these.

    def _add_colour(self, device_s: float, image: Image) -> None:
        self._put(self._pairing.add_colour(device_s, image))

    def _add_depth(self, device_s: float, image: Image) -> None:
        self._put(self._pairing.add_depth(device_s, image))

    def _put(self, pairs: list[ImagePair]) -> None:
        for pair in pairs:
            self._mailbox.put(pair)

    def _end(self, end: Exception) -> None:
        with suppress(MailboxClosedError):
            self._put(self._pairing.finish())
        self._mailbox.finish(end)
