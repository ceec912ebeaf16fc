"""Device clocks: unwrapping of stamps, mapping to the host's clock, and pairing by stamp."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from drivers.camera import MAX_PAIR_SKEW_US

# The largest drift between two good crystals; an older minimum loses weight by it.
MAX_CLOCK_DRIFT = 20e-6
DELAY_WINDOW_S = 20.0
# After a gap of this length the delays measured before it are discarded.
MAX_GAP_S = 30.0
# While stamps are ahead, host time advances at this fraction of the device's rate.
MIN_CLOCK_RATE = 0.5


class StampUnwrapper:
    """Unwraps the stamps of a counter; the first stamp is taken as it is.

    The streams of one device share one counter and one object. Each stamp is unwrapped to the value
    nearest to the previous stamp of any stream, so streams may be out of order even around a wrap.
    Consecutive stamps must be less than half a wrap apart (Kinect: 35.8 s).
    """

    def __init__(self, ticks_per_second: float, bits: int) -> None:
        self._ticks_per_second = ticks_per_second
        self._period_ticks = 1 << bits
        self._ticks: int | None = None

    def unwrap_s(self, stamp: int) -> float:
        """Return the seconds since the counter's zero, for the counter value `stamp`."""
        if self._ticks is None:
            self._ticks = stamp
        half = self._period_ticks // 2
        self._ticks += (stamp - self._ticks + half) % self._period_ticks - half
        return self._ticks / self._ticks_per_second


@dataclass(frozen=True)
class _DelaySample:
    """A frame's delay: receive time minus stamp, corrected for the largest drift."""

    device_s: float
    delay_s: float


class HostClockSync:
    """Maps one stream's device seconds to CLOCK_MONOTONIC.

    A frame can arrive late but never early. So the smallest difference between receive time and
    stamp in the last 20 s belongs to a frame without extra delay. Such a frame takes `readout_s`
    from the instant of its stamp until the host has received all of it.
    Host times never go back: when the smallest difference shrinks, they advance at half the rate
    until they agree. After a gap of 30 s the estimate starts again.
    """

    def __init__(self, readout_s: float) -> None:
        self._readout_s = readout_s
        self._min_delays: deque[_DelaySample] = deque()
        self._device_s = self._host_s = self._receive_time_s = -math.inf

    def to_host_s(self, device_s: float, receive_time_s: float) -> float:
        """Convert a frame's device stamp to CLOCK_MONOTONIC; call it for frames in order.

        Args:
            device_s: Stamp on the device's clock.
            receive_time_s: CLOCK_MONOTONIC when the host had received the whole frame.
        """
        step_s = device_s - self._device_s
        if abs(step_s) > MAX_GAP_S or receive_time_s - self._receive_time_s > MAX_GAP_S:
            self._min_delays.clear()
            step_s = 0.0
        self._add_sample(
            _DelaySample(device_s, receive_time_s - device_s - MAX_CLOCK_DRIFT * device_s)
        )
        instant_s = (
            device_s + self._min_delays[0].delay_s + MAX_CLOCK_DRIFT * device_s - self._readout_s
        )
        earliest_s = self._host_s + MIN_CLOCK_RATE * max(step_s, 0.0)
        self._device_s, self._receive_time_s = device_s, receive_time_s
        self._host_s = max(instant_s, earliest_s)
        return self._host_s

    def _add_sample(self, sample: _DelaySample) -> None:
        """Update the sliding-window minimum; the first element is the smallest delay."""
        while self._min_delays and self._min_delays[-1].delay_s >= sample.delay_s:
            self._min_delays.pop()
        self._min_delays.append(sample)
        while self._min_delays[0].device_s < sample.device_s - DELAY_WINDOW_S:
            self._min_delays.popleft()


MAX_PAIR_SKEW_S = MAX_PAIR_SKEW_US / 1e6
# The streams have at most 30 images per second; the period leaves some room for jitter.
MIN_IMAGE_PERIOD_S = 0.030
# The largest lag, in images, of one stream behind the other.
MAX_HELD_IMAGES = 4

C = TypeVar("C")
D = TypeVar("D")


@dataclass(frozen=True)
class StampedPair(Generic[C, D]):
    """A depth image and the color image nearest to it."""

    color_s: float
    color: C
    depth_s: float
    depth: D

    @property
    def skew_s(self) -> float:
        """Stamp of depth minus stamp of color."""
        return self.depth_s - self.color_s


class NearestFramePairing(Generic[C, D]):
    """Pairs color and depth images by their device stamps, in any order of arrival.

    A depth image is paired as soon as no later color image can be nearer: a color image at or
    after it has arrived, or one so shortly before it that the next must be farther. With 30 images
    per second a depth image waits at most half a period (17 ms), and always gets the nearest color
    image. A color image has at most one partner.
    The stamps of each stream must rise. `unpaired` counts depth images without a partner, except
    those before the first color image, because the streams do not start at the same instant.
    """

    def __init__(self, min_period_s: float = MIN_IMAGE_PERIOD_S) -> None:
        self._half_min_period_s = min_period_s / 2
        self._colors: deque[tuple[float, C]] = deque()
        self._depths: deque[tuple[float, D]] = deque()
        self._first_color_s, self._last_discarded_s = math.inf, -math.inf  # stamps of color images
        self.unpaired = 0

    def add_color(self, stamp_s: float, image: C) -> list[StampedPair[C, D]]:
        """Add a color image and return the pairs that it completes, in order."""
        self._first_color_s = min(self._first_color_s, stamp_s)
        self._colors.append((stamp_s, image))
        pairs = self._pair_decidable()
        if len(self._colors) > MAX_HELD_IMAGES:
            self._last_discarded_s, _ = self._colors.popleft()
        return pairs

    def add_depth(self, stamp_s: float, image: D) -> list[StampedPair[C, D]]:
        """Add a depth image and return its pair, if it can be paired already."""
        self._depths.append((stamp_s, image))
        pairs = self._pair_decidable()
        if len(self._depths) > MAX_HELD_IMAGES:
            self._count_unpaired(self._depths.popleft()[0])
        return pairs

    def finish(self) -> list[StampedPair[C, D]]:
        """Pair the remaining images; no image may follow."""
        return [pair for _ in range(len(self._depths)) for pair in self._pair_oldest()]

    def _pair_decidable(self) -> list[StampedPair[C, D]]:
        pairs: list[StampedPair[C, D]] = []
        while self._depths and self._is_decidable(self._depths[0][0]):
            pairs += self._pair_oldest()
        return pairs

    def _is_decidable(self, depth_s: float) -> bool:
        return bool(self._colors) and depth_s - self._colors[-1][0] <= self._half_min_period_s

    def _pair_oldest(self) -> list[StampedPair[C, D]]:
        """Pair the oldest waiting depth image, if it has a partner."""
        depth_s, depth = self._depths.popleft()
        stamps_s = [self._last_discarded_s, *(stamp_s for stamp_s, _ in self._colors)]
        nearest = min(range(len(stamps_s)), key=lambda i: abs(stamps_s[i] - depth_s))
        if nearest == 0 or abs(stamps_s[nearest] - depth_s) > MAX_PAIR_SKEW_S:
            self._count_unpaired(depth_s)
            return []
        for _ in range(nearest):  # nothing older can be nearest to a later depth image
            self._last_discarded_s, color = self._colors.popleft()
        return [StampedPair(self._last_discarded_s, color, depth_s, depth)]

    def _count_unpaired(self, depth_s: float) -> None:
        self.unpaired += depth_s >= self._first_color_s
