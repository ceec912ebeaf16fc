"""libfreenect's log, and the health of the streams by it."""

import logging
import re
import time
from collections import deque

WARNING_LEVEL = 2
HEALTH_WINDOW_S = 1.0
_log = logging.getLogger("libfreenect")
_STREAM_LINE = re.compile(r"\[Stream (70|80)\] (.*)")
_LOST_PACKETS = re.compile(r"Lost (\d+) packets")
_SHORT_PACKET = re.compile(r"Expected \d+ data bytes")
_IMAGE_DONE = re.compile(r"Got (depth|video) frame of size \d+/\d+, (\d+)/(\d+) packets")


class StreamHealth:
    """The counters of one stream. libfreenect's thread writes them; others may read.

    Attributes:
        images: Images that the device sent, incomplete ones included.
        incomplete: Images with missing packets. libfreenect delivers them with old pixels in the
            gaps, or discards them.
        lost_packets: Packets that never arrived.
        last_activity_s: CLOCK_MONOTONIC of the last image or warning; 0 before the first. A stream
            with warnings is alive.
    """

    def __init__(self) -> None:
        self.images = self.incomplete = self.lost_packets = 0
        self.last_activity_s = 0.0
        self._is_incomplete = False
        self._recent: deque[tuple[float, bool]] = deque(maxlen=100)

    def add_warning(self, text: str) -> None:
        """Parse a warning about this stream's packets."""
        self.last_activity_s = time.monotonic()
        if lost := _LOST_PACKETS.match(text):
            self.lost_packets += int(lost[1])
        elif "esync" in text:  # "resyncing": the rest of the image is discarded
            self._add_image(is_incomplete=True)
        elif _SHORT_PACKET.match(text):
            self._is_incomplete = True

    def check_packet_count(self, packets: int, expected: int) -> None:
        """Check the packets of the image that is delivered next."""
        self._is_incomplete |= packets < expected

    def add_delivered(self, now_s: float) -> bool:
        """Count a delivered image; return whether it is complete."""
        self.last_activity_s = now_s
        is_incomplete, self._is_incomplete = self._is_incomplete, False
        self._add_image(is_incomplete)
        return not is_incomplete

    def count_recent(self, now_s: float) -> tuple[int, int]:
        """Return the numbers of incomplete images and of all images in the last second."""
        since_s = now_s - HEALTH_WINDOW_S
        recent = [is_incomplete for s, is_incomplete in self._recent.copy() if s >= since_s]
        return sum(recent), len(recent)

    def _add_image(self, is_incomplete: bool) -> None:
        self.images += 1
        self.incomplete += is_incomplete
        self._recent.append((self.last_activity_s, is_incomplete))


class LibfreenectLog:
    """Parses libfreenect's log at its level SPEW, which has one line for each image."""

    def __init__(self) -> None:
        self.color, self.depth = StreamHealth(), StreamHealth()
        self._warnings: deque[str] = deque(maxlen=50)

    def add_line(self, level: int, text: str) -> None:
        """Parse one line of libfreenect's log callback."""
        if match := _IMAGE_DONE.match(text):
            stream = self.depth if match[1] == "depth" else self.color
            stream.check_packet_count(int(match[2]), int(match[3]))
        elif match := _STREAM_LINE.match(text):
            if _is_warning(match[2]):
                _log.debug("%s", text.strip())
                (self.depth if match[1] == "70" else self.color).add_warning(match[2])
        else:
            _log.debug("%s", text.strip())
            if level <= WARNING_LEVEL:
                self._warnings.append(text.strip())

    def contains(self, text: str) -> bool:
        """Whether a warning or error contains this text."""
        return bool(self.find(text))

    def find(self, text: str) -> str:
        """Return the first warning or error that contains this text; "" if there is none."""
        return next((line for line in self._warnings if text in line), "")

    @property
    def last_line(self) -> str:
        """The last warning or error, for an error message."""
        return self._warnings[-1] if self._warnings else "libfreenect gives no reason"


def _is_warning(text: str) -> bool:
    """Whether a stream's line is a warning: not its packet size, nor that it is not synced yet."""
    return not text.startswith(("Negotiated", "Not synced"))
