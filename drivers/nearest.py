"""Live pairing of two free-running streams: each depth image with the nearest colour image."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

# Images farther apart than this are of two different instants.
MAX_PAIR_SKEW_S = 0.020
# No stream of these sensors sends faster than 30 images a second; the rest is room for jitter.
MIN_IMAGE_PERIOD_S = 0.030
# How far, in images, one stream may be behind the other.
MAX_HELD_IMAGES = 4

C = TypeVar("C")
D = TypeVar("D")


@dataclass(frozen=True)
class StampedPair(Generic[C, D]):
    """A depth image and the colour image nearest to it."""

    color_s: float
    color: C
    depth_s: float
    depth: D

    @property
    def skew_s(self) -> float:
        """Instant of depth minus instant of colour."""
        return self.depth_s - self.color_s


class NearestFramePairing(Generic[C, D]):
    """Pairs images by their device stamps, in whichever order the two streams arrive.

    A depth image is decided on as soon as no colour image still to come can be nearer: a colour
    image at or after it is there, or one so shortly before it that the next must be farther. With
    both streams at 30 a second it waits at most half a period (17 ms) for its partner, and never
    has the farther neighbour. A colour image has at most one partner.
    Each stream's stamps must rise. `unpaired` counts depth images without a partner, those from
    before the first colour image left out: the streams do not start at the same instant.
    """

    def __init__(
        self, max_skew_s: float = MAX_PAIR_SKEW_S, min_period_s: float = MIN_IMAGE_PERIOD_S
    ) -> None:
        self._max_skew_s = max_skew_s
        self._half_min_period_s = min_period_s / 2
        self._colors: deque[tuple[float, C]] = deque()
        self._depths: deque[tuple[float, D]] = deque()
        self._first_color_s, self._last_discarded_s = math.inf, -math.inf  # stamps of colour images
        self.unpaired = 0

    def add_color(self, stamp_s: float, image: C) -> list[StampedPair[C, D]]:
        """The pairs that this colour image decides, in order."""
        self._first_color_s = min(self._first_color_s, stamp_s)
        self._colors.append((stamp_s, image))
        pairs = self._pair_decidable()
        if len(self._colors) > MAX_HELD_IMAGES:
            self._last_discarded_s, _ = self._colors.popleft()
        return pairs

    def add_depth(self, stamp_s: float, image: D) -> list[StampedPair[C, D]]:
        """The pairs that this depth image decides: itself, or none yet."""
        self._depths.append((stamp_s, image))
        pairs = self._pair_decidable()
        if len(self._depths) > MAX_HELD_IMAGES:
            self._count_unpaired(self._depths.popleft()[0])
        return pairs

    def finish(self) -> list[StampedPair[C, D]]:
        """The pairs among what is still undecided; no image follows."""
        return [pair for _ in range(len(self._depths)) for pair in self._pair_oldest()]

    def _pair_decidable(self) -> list[StampedPair[C, D]]:
        pairs: list[StampedPair[C, D]] = []
        while self._depths and self._is_decidable(self._depths[0][0]):
            pairs += self._pair_oldest()
        return pairs

    def _is_decidable(self, depth_s: float) -> bool:
        return bool(self._colors) and depth_s - self._colors[-1][0] <= self._half_min_period_s

    def _pair_oldest(self) -> list[StampedPair[C, D]]:
        """The pair of the oldest depth image that waits, if it has a partner."""
        depth_s, depth = self._depths.popleft()
        stamps_s = [self._last_discarded_s, *(stamp_s for stamp_s, _ in self._colors)]
        nearest = min(range(len(stamps_s)), key=lambda i: abs(stamps_s[i] - depth_s))
        if nearest == 0 or abs(stamps_s[nearest] - depth_s) > self._max_skew_s:
            self._count_unpaired(depth_s)
            return []
        for _ in range(nearest):  # nothing older can be nearest to a later depth image
            self._last_discarded_s, colour = self._colors.popleft()
        return [StampedPair(self._last_discarded_s, colour, depth_s, depth)]

    def _count_unpaired(self, depth_s: float) -> None:
        self.unpaired += depth_s >= self._first_color_s
