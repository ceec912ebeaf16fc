"""Lines that a log shows at its default level, although nothing is wrong."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

# A log tells of work that goes on for longer: nobody shall wait 2 s without a reason.
SLOW_AFTER_S = 1.5

# Its own level counts, not the root's: the root's handlers show whatever is logged here.
_logger = logging.getLogger("kinect-vo.announcements")
_logger.setLevel(logging.INFO)


def announce(text: str) -> None:
    """Log a line at level info, shown unless only errors are wanted (``log.level = "error"``)."""
    if logging.getLogger().level <= logging.WARNING:
        _logger.info("%s", text)


@contextmanager
def announce_if_slow(label: str) -> Iterator[None]:
    """Two lines if the block takes long: one when that is seen, and one when it is over."""
    begin_s = time.monotonic()
    timer = threading.Timer(SLOW_AFTER_S, announce, [f"{label} ..."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        was_told = timer.finished.is_set()
        timer.cancel()
        timer.join()
        if was_told:
            announce(f"{label}: ended after {time.monotonic() - begin_s:.1f} s")
