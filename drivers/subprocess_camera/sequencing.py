"""The numbers and stamps of frames as a reader of a camera in a process gets them."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import Clock, PlaybackMode, RgbdFrame

Sequencer = Callable[[RgbdFrame], RgbdFrame | None]


def make_sequencer(clock: Clock, playback_mode: PlaybackMode) -> Sequencer:
    """Make the function that returns a frame as delivered, or None for a frame to discard."""
    if clock is Clock.MONOTONIC:
        return MonotonicSequence()
    return stamp_receive_time if playback_mode is PlaybackMode.LOCKSTEP else pass_through


class MonotonicSequence:
    """Keeps `seq` and stamps of a live camera rising, however often it is opened again.

    A camera that is opened again counts from 0; its numbers continue here from the last one. Its
    new clock estimate may put its first frames before the last ones: those are discarded.
    """

    def __init__(self) -> None:
        self._last_stamp_s = -float("inf")
        self._last_seq = -1
        self._seq_offset = 0

    def __call__(self, frame: RgbdFrame) -> RgbdFrame | None:
        """Return the frame with its new number; None if its stamp does not rise."""
        if frame.stamp_s <= self._last_stamp_s:
            return None
        if frame.seq + self._seq_offset <= self._last_seq:
            self._seq_offset = self._last_seq + 1 - frame.seq
        self._last_stamp_s, self._last_seq = frame.stamp_s, frame.seq + self._seq_offset
        return replace(frame, seq=self._last_seq) if self._seq_offset else frame


def stamp_receive_time(frame: RgbdFrame) -> RgbdFrame:
    """Set the receive time to now: in lockstep a frame arrives when it is read."""
    return replace(frame, receive_time_s=time.monotonic())


def pass_through(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame unchanged, for a recording in realtime."""
    return frame
