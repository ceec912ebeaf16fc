"""What a reader sees of frames that come from one process after another."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import Clock, PlaybackMode, RgbdFrame

Sequencer = Callable[[RgbdFrame], RgbdFrame | None]


def make_sequencer(clock: Clock, playback_mode: PlaybackMode) -> Sequencer:
    """The rule for a camera: a frame as it is to be delivered, or None for one that must not be."""
    if clock is Clock.MONOTONIC:
        return MonotonicSequence()
    return stamp_receive_time if playback_mode is PlaybackMode.LOCKSTEP else pass_through


class MonotonicSequence:
    """A live camera: `seq` and stamps rise for ever, however often it is opened again.

    A camera that was opened again counts from 0, and here on from the last number. Its new idea of
    the device's clock may put its first frames before the last ones: those are left out.
    """

    def __init__(self) -> None:
        self._last_stamp_s = -float("inf")
        self._last_seq = -1
        self._seq_offset = 0

    def __call__(self, frame: RgbdFrame) -> RgbdFrame | None:
        """The frame with its number here; None if its stamp does not rise."""
        if frame.stamp_s <= self._last_stamp_s:
            return None
        if frame.seq + self._seq_offset <= self._last_seq:
            self._seq_offset = self._last_seq + 1 - frame.seq
        self._last_stamp_s, self._last_seq = frame.stamp_s, frame.seq + self._seq_offset
        return replace(frame, seq=self._last_seq)


def stamp_receive_time(frame: RgbdFrame) -> RgbdFrame:
    """A recording in lockstep: a frame arrives when it is asked for, as without a process."""
    return replace(frame, receive_time_s=time.monotonic())


def pass_through(frame: RgbdFrame) -> RgbdFrame:
    """A recording at its own pace."""
    return frame
