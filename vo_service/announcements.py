"""Lines that a log shows at its default level, although nothing is wrong."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

# A log tells of work that goes on for longer: nobody shall wait 2 s without a reason.
LONG_S = 1.5

# Its own level counts, not the root's: the root's handlers show whatever is logged here.
_logger = logging.getLogger("kinect-vo.announcements")
_logger.setLevel(logging.INFO)


def announce(text: str) -> None:
    """Log a line at level info, shown unless only errors are wanted (``log.level = "error"``)."""
    if logging.getLogger().level <= logging.WARNING:
        _logger.info("%s", text)


class LongWork:
    """Two lines for work that takes long: one when that is seen, and one when it is over."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._begin_s = time.monotonic()
        self._is_told = False

    def goes_on(self) -> None:
        """Tell it, if it has taken long enough by now."""
        if not self._is_told and time.monotonic() - self._begin_s >= LONG_S:
            self._is_told = True
            announce(f"{self._label} ...")

    def end(self) -> None:
        """Tell how long it took, if it was told that it goes on."""
        if self._is_told:
            self._is_told = False
            announce(f"{self._label}: ended after {time.monotonic() - self._begin_s:.1f} s")


@contextmanager
def long_work(label: str) -> Iterator[None]:
    """`LongWork` for what is done in the block, which need not say that it goes on."""
    work = LongWork(label)
    timer = threading.Timer(LONG_S, work.goes_on)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        work.end()
