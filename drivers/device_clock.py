"""A device's own clock: counted on through its wraps, and set against the host's."""

import math
from collections import deque
from dataclasses import dataclass

# Two good crystals differ by up to this much; an older minimum is trusted that much less.
MAX_CLOCK_DRIFT = 20e-6
DELAY_WINDOW_S = 20.0
# Without a frame for this long, what was known of the two clocks is out of date.
MAX_GAP_S = 30.0
# While stamps are too far ahead, they go on at this share of the device's pace.
MIN_CLOCK_RATE = 0.5


class StampUnwrapper:
    """Seconds of a counter that wraps; the first stamp is taken as it is.

    The streams of one device share one counter and so share one object: each stamp is the one
    nearest to the stamp before, of whichever stream, so that streams may come out of order even
    around a wrap. Exact while neighbours are less than half a wrap apart (Kinect: 35.8 s).
    """

    def __init__(self, ticks_per_second: float, bits: int) -> None:
        self._ticks_per_second = ticks_per_second
        self._period_ticks = 1 << bits
        self._ticks: int | None = None

    def unwrap_s(self, stamp: int) -> float:
        """Seconds since the counter's zero, `stamp` being the counter's value."""
        if self._ticks is None:
            self._ticks = stamp
        half = self._period_ticks // 2
        self._ticks += (stamp - self._ticks + half) % self._period_ticks - half
        return self._ticks / self._ticks_per_second


@dataclass(frozen=True)
class _DelaySample:
    """How late a frame came: its arrival minus its stamp, less the leak up to that stamp."""

    device_s: float
    delay_s: float


class HostClockSync:
    """Maps one stream's device seconds to CLOCK_MONOTONIC.

    A frame can come late but never early. So the smallest difference between arrival and stamp
    seen in the last 20 s is that of a frame which nothing held up, and such a frame needs
    `readout_s` from the instant that the stamp marks until the host has all of it.
    Stamps always rise: where the difference turns out to be smaller than thought, time goes on at
    half its pace until that is made good. After a gap of 30 s everything is learnt anew.
    """

    def __init__(self, readout_s: float) -> None:
        self._readout_s = readout_s
        self._min_delays: deque[_DelaySample] = deque()
        self._device_s = self._host_s = self._receive_time_s = -math.inf

    def to_host_s(self, device_s: float, receive_time_s: float) -> float:
        """The instant of `device_s`, of a frame that was whole at `receive_time_s`; frames in order."""
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
        """Keep what is, or may later be, the soonest of the window: the first is the soonest."""
        while self._min_delays and self._min_delays[-1].delay_s >= sample.delay_s:
            self._min_delays.pop()
        self._min_delays.append(sample)
        while self._min_delays[0].device_s < sample.device_s - DELAY_WINDOW_S:
            self._min_delays.popleft()
