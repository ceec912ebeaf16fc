"""Live pairing of two free-running streams: each depth image with the nearest colour image."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

# Images farther apart than this are of two different instants.
TOLERANCE_S = 0.020
# No stream of these sensors sends faster than 30 images a second; the rest is room for jitter.
SHORTEST_PERIOD_S = 0.030
# How far, in images, one stream may be behind the other.
HELD = 4

C = TypeVar("C")
D = TypeVar("D")


@dataclass(frozen=True)
class Pair(Generic[C, D]):
    """A depth image and the colour image nearest to it."""

    colour_s: float
    colour: C
    depth_s: float
    depth: D

    @property
    def skew_s(self) -> float:
        """Instant of depth minus instant of colour."""
        return self.depth_s - self.colour_s


class NearestPairing(Generic[C, D]):
    """Pairs images by their device stamps, in whichever order the two streams arrive.

    A depth image is decided on as soon as no colour image still to come can be nearer: a colour
    image at or after it is there, or one so shortly before it that the next must be farther. With
    both streams at 30 a second it waits at most half a period (17 ms) for its partner, and never
    has the farther neighbour. A colour image has at most one partner.
    Each stream's stamps must rise. `unpaired` counts depth images without a partner, those from
    before the first colour image left out: the streams do not start at the same instant.
    """

    def __init__(
        self, tolerance_s: float = TOLERANCE_S, shortest_period_s: float = SHORTEST_PERIOD_S
    ) -> None:
        self._tolerance_s = tolerance_s
        self._sure_s = shortest_period_s / 2
        self._colours: deque[tuple[float, C]] = deque()
        self._depths: deque[tuple[float, D]] = deque()
        self._first_s, self._forgotten_s = math.inf, -math.inf  # stamps of colour images
        self.unpaired = 0

    def add_colour(self, stamp_s: float, image: C) -> list[Pair[C, D]]:
        """The pairs that this colour image decides, in order."""
        self._first_s = min(self._first_s, stamp_s)
        self._colours.append((stamp_s, image))
        pairs = self._settle()
        if len(self._colours) > HELD:
            self._forgotten_s, _ = self._colours.popleft()
        return pairs

    def add_depth(self, stamp_s: float, image: D) -> list[Pair[C, D]]:
        """The pairs that this depth image decides: itself, or none yet."""
        self._depths.append((stamp_s, image))
        pairs = self._settle()
        if len(self._depths) > HELD:
            self._count_unpaired(self._depths.popleft()[0])
        return pairs

    def finish(self) -> list[Pair[C, D]]:
        """The pairs among what is still undecided; no image follows."""
        return [pair for _ in range(len(self._depths)) for pair in self._decide()]

    def _settle(self) -> list[Pair[C, D]]:
        pairs: list[Pair[C, D]] = []
        while self._depths and self._is_sure(self._depths[0][0]):
            pairs += self._decide()
        return pairs

    def _is_sure(self, depth_s: float) -> bool:
        return bool(self._colours) and depth_s - self._colours[-1][0] <= self._sure_s

    def _decide(self) -> list[Pair[C, D]]:
        """The pair of the oldest depth image that waits, if it has a partner."""
        depth_s, depth = self._depths.popleft()
        stamps_s = [self._forgotten_s, *(stamp_s for stamp_s, _ in self._colours)]
        nearest = min(range(len(stamps_s)), key=lambda i: abs(stamps_s[i] - depth_s))
        if nearest == 0 or abs(stamps_s[nearest] - depth_s) > self._tolerance_s:
            self._count_unpaired(depth_s)
            return []
        for _ in range(nearest):  # nothing older can be nearest to a later depth image
            self._forgotten_s, colour = self._colours.popleft()
        return [Pair(self._forgotten_s, colour, depth_s, depth)]

    def _count_unpaired(self, depth_s: float) -> None:
        self.unpaired += depth_s >= self._first_s
