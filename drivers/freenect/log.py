"""What libfreenect says only in its log: which images miss packets, and why something failed."""

import logging
import re
import time
from collections import deque

WARNING = 2
HEALTH_WINDOW_S = 1.0
_log = logging.getLogger("libfreenect")
_ABOUT_STREAM = re.compile(r"\[Stream (70|80)\] (.*)")
_LOST = re.compile(r"Lost (\d+) packets")
_SHORT = re.compile(r"Expected \d+ data bytes")
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
        self.images = self.torn = self.lost_packets = 0
        self.heard_s = 0.0
        self._is_torn = False
        self._recent: deque[tuple[float, bool]] = deque(maxlen=100)

    def complaint(self, text: str) -> None:
        """A line about this stream's packets."""
        self.heard_s = time.monotonic()
        if lost := _LOST.match(text):
            self.lost_packets += int(lost[1])
        elif "esync" in text:  # "resyncing": the rest of the image is thrown away
            self._count(is_torn=True)
        elif _SHORT.match(text):
            self._is_torn = True

    def image_done(self, packets: int, expected: int) -> None:
        """An image of so many packets is about to be delivered."""
        self._is_torn |= packets < expected

    def delivered(self, now_s: float) -> bool:
        """An image is delivered; True if it is whole."""
        self.heard_s = now_s
        is_torn, self._is_torn = self._is_torn, False
        self._count(is_torn)
        return not is_torn

    def recent(self, now_s: float) -> tuple[int, int]:
        """Torn images and all images of the last second."""
        torn = [is_torn for s, is_torn in self._recent.copy() if s >= now_s - HEALTH_WINDOW_S]
        return sum(torn), len(torn)

    def _count(self, is_torn: bool) -> None:
        self.images += 1
        self.torn += is_torn
        self._recent.append((self.heard_s, is_torn))


class Log:
    """Reads libfreenect's log at its level SPEW, one line for each image."""

    def __init__(self) -> None:
        self.colour, self.depth = StreamHealth(), StreamHealth()
        self._complaints: deque[str] = deque(maxlen=50)

    def line(self, level: int, text: str) -> None:
        """One line, as libfreenect's callback gets it."""
        if done := _IMAGE_DONE.match(text):
            stream = self.depth if done[1] == "depth" else self.colour
            stream.image_done(int(done[2]), int(done[3]))
        elif about := _ABOUT_STREAM.match(text):
            if _is_complaint(about[2]):
                _log.debug("%s", text.strip())
                (self.depth if about[1] == "70" else self.colour).complaint(about[2])
        else:
            _log.debug("%s", text.strip())
            if level <= WARNING:
                self._complaints.append(text.strip())

    def has(self, words: str) -> bool:
        """Whether libfreenect has complained of this."""
        return bool(self.find(words))

    def find(self, words: str) -> str:
        """The first complaint with these words; "" if there is none."""
        return next((line for line in self._complaints if words in line), "")

    @property
    def last_words(self) -> str:
        """The last complaint, for an error message."""
        return self._complaints[-1] if self._complaints else "libfreenect does not say why"


def _is_complaint(text: str) -> bool:
    """Also told about a stream: its packet size at the start, and that it is not synced yet."""
    return not text.startswith(("Negotiated", "Not synced"))
