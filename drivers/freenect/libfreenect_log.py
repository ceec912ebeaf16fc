"""What libfreenect says only in its log: which images miss packets, and why something failed."""

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
    """How one stream fares. The thread that runs libfreenect writes; others may read.

    images   images that the device sent, those that never arrived whole included
    torn     those of them that missed packets: libfreenect delivers them with old pixels in the
             holes, or gives them up
    heard_s  CLOCK_MONOTONIC of the last image or complaint (a stream that complains is alive);
             0 before the first
    """

    def __init__(self) -> None:
        self.images = self.incomplete = self.lost_packets = 0
        self.last_activity_s = 0.0
        self._is_incomplete = False
        self._recent: deque[tuple[float, bool]] = deque(maxlen=100)

    def add_warning(self, text: str) -> None:
        """A line about this stream's packets."""
        self.last_activity_s = time.monotonic()
        if lost := _LOST_PACKETS.match(text):
            self.lost_packets += int(lost[1])
        elif "esync" in text:  # "resyncing": the rest of the image is thrown away
            self._add_image(is_incomplete=True)
        elif _SHORT_PACKET.match(text):
            self._is_incomplete = True

    def check_packet_count(self, packets: int, expected: int) -> None:
        """An image of so many packets is about to be delivered."""
        self._is_incomplete |= packets < expected

    def add_delivered(self, now_s: float) -> bool:
        """An image is delivered; True if it is whole."""
        self.last_activity_s = now_s
        is_torn, self._is_incomplete = self._is_incomplete, False
        self._add_image(is_torn)
        return not is_torn

    def count_recent(self, now_s: float) -> tuple[int, int]:
        """Torn images and all images of the last second."""
        torn = [is_torn for s, is_torn in self._recent.copy() if s >= now_s - HEALTH_WINDOW_S]
        return sum(torn), len(torn)

    def _add_image(self, is_incomplete: bool) -> None:
        self.images += 1
        self.incomplete += is_incomplete
        self._recent.append((self.last_activity_s, is_incomplete))


class LibfreenectLog:
    """Reads libfreenect's log at its level SPEW, one line for each image."""

    def __init__(self) -> None:
        self.color, self.depth = StreamHealth(), StreamHealth()
        self._warnings: deque[str] = deque(maxlen=50)

    def add_line(self, level: int, text: str) -> None:
        """One line, as libfreenect's callback gets it."""
        if done := _IMAGE_DONE.match(text):
            stream = self.depth if done[1] == "depth" else self.color
            stream.check_packet_count(int(done[2]), int(done[3]))
        elif about := _STREAM_LINE.match(text):
            if _is_warning(about[2]):
                _log.debug("%s", text.strip())
                (self.depth if about[1] == "70" else self.color).add_warning(about[2])
        else:
            _log.debug("%s", text.strip())
            if level <= WARNING_LEVEL:
                self._warnings.append(text.strip())

    def contains(self, text: str) -> bool:
        """Whether libfreenect has complained of this."""
        return bool(self.find(text))

    def find(self, text: str) -> str:
        """The first complaint with these words; "" if there is none."""
        return next((line for line in self._warnings if text in line), "")

    @property
    def last_line(self) -> str:
        """The last complaint, for an error message."""
        return self._warnings[-1] if self._warnings else "libfreenect does not say why"


def _is_warning(text: str) -> bool:
    """Also told about a stream: its packet size at the start, and that it is not synced yet."""
    return not text.startswith(("Negotiated", "Not synced"))
