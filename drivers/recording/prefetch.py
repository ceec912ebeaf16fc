"""Decoding ahead of the reader: frames of a recording, and their buffers in both playback modes."""

import math
import threading
import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

from drivers.camera import CameraCounters, FrameTimeout, RgbdFrame
from drivers.core import CameraError
from drivers.recording import DepthImage, FramePair, Recording
from drivers.rectify import SoftwareRegistration, Undistorter

MAX_BUFFERED_FRAMES = 4
NOT_OPEN = "the recording is not open; use `with`, or call open()"


class BufferClosedError(Exception):
    """The buffer is closed, so the decoding thread must end."""


NO_COUNTS = CameraCounters()


class FrameBuffer(ABC):
    """At most `MAX_BUFFERED_FRAMES` decoded frames in order, from one thread to another."""

    def __init__(self, earlier_counters: CameraCounters = NO_COUNTS) -> None:
        self._changed = threading.Condition()
        self._frames: deque[RgbdFrame] = deque()
        self._end: Exception | None = None
        self._earlier_counters = earlier_counters
        self._delivered = self._dropped = self._skipped = 0

    @abstractmethod
    def next_index(self, index: int) -> int:
        """Return the index of the frame to decode, `index` or a later one."""

    @abstractmethod
    def put(self, frame: RgbdFrame) -> None:
        """Add a frame and wait until there is room for another.

        Raises:
            BufferClosedError: If the buffer is closed.
        """

    @abstractmethod
    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame of this playback mode.

        Raises:
            FrameTimeout: No frame is ready within `timeout_s`.
            Exception: The exception given to `finish`, when no frame is left.
        """

    def count_skipped(self) -> None:
        """Count a frame that could not be decoded."""
        with self._changed:
            self._skipped += 1

    def finish(self, exception: Exception) -> None:
        """End the stream: after the last frame `get` raises `exception`."""
        with self._changed:
            self._end = self._end or exception
            self._changed.notify_all()

    def close(self) -> None:
        """Discard the frames and wake both threads."""
        with self._changed:
            self._frames.clear()
            self._end = CameraError(NOT_OPEN)
            self._changed.notify_all()

    @property
    def counters(self) -> CameraCounters:
        """Totals of delivered, dropped and skipped frames, with those of the buffers before."""
        with self._changed:
            own = CameraCounters(self._delivered, self._dropped, self._skipped)
        return self._earlier_counters + own

    def _append(self, frame: RgbdFrame) -> None:
        if self._end is not None:
            raise BufferClosedError
        self._frames.append(frame)
        self._changed.notify_all()

    def _deliver_oldest(self, receive_time_s: float) -> RgbdFrame:
        self._delivered += 1
        self._changed.notify_all()
        return replace(self._frames.popleft(), receive_time_s=receive_time_s)

    def _is_full(self) -> bool:
        return self._end is None and len(self._frames) >= MAX_BUFFERED_FRAMES


class LockstepBuffer(FrameBuffer):
    """Delivers every frame when it is read."""

    def next_index(self, index: int) -> int:
        """Return `index`: every frame is decoded."""
        return index

    def put(self, frame: RgbdFrame) -> None:
        """Add a frame and wait while the reader is behind."""
        with self._changed:
            self._append(frame)
            self._changed.wait_for(lambda: not self._is_full())

    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame; its receive time is now."""
        with self._changed:
            self._changed.wait_for(lambda: self._frames or self._end, timeout_s)
            if self._frames:
                return self._deliver_oldest(time.monotonic())
            raise self._end or FrameTimeout


class RealtimeBuffer(FrameBuffer):
    """Delivers each frame when it is due; frames that were not read in time are dropped.

    Playback starts when the first frame is read.

    Args:
        offsets_s: Stamps of the frames relative to the first; a frame's `seq` is its index here.
        earlier_counters: Totals of the buffers before.
        clock: Returns the time in seconds.
    """

    def __init__(
        self,
        offsets_s: Sequence[float],
        earlier_counters: CameraCounters = NO_COUNTS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(earlier_counters)
        self._offsets_s = offsets_s
        self._clock = clock
        self._start_s = math.inf

    def next_index(self, index: int) -> int:
        """Skip frames that are outdated already, without decoding them."""
        with self._changed:
            newest_due = bisect_right(self._offsets_s, self._clock() - self._start_s) - 1
            next_index = max(index, newest_due)
            self._dropped += next_index - index
            return next_index

    def put(self, frame: RgbdFrame) -> None:
        """Add a frame; while the buffer is full, wait until the oldest is read or outdated."""
        with self._changed:
            self._append(frame)
            self._drop_outdated()
            while self._is_full():
                self._changed.wait(self._seconds_until_due(self._frames[1]))
                self._drop_outdated()

    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait for a due frame; its receive time is the later one of due and decoded."""
        with self._changed:
            if self._start_s == math.inf:
                self._start_s = self._clock()
                self._changed.notify_all()
            deadline_s = self._clock() + timeout_s
            while True:
                self._drop_outdated()
                if self._frames and self._seconds_until_due(self._frames[0]) == 0.0:
                    due_s = self._due_s(self._frames[0])
                    return self._deliver_oldest(max(due_s, self._frames[0].receive_time_s))
                if not self._frames and self._end:
                    raise self._end
                left_s = deadline_s - self._clock()
                if left_s <= 0.0:
                    raise FrameTimeout
                due_in_s = self._seconds_until_due(self._frames[0]) if self._frames else left_s
                self._changed.wait(min(left_s, due_in_s))

    def _drop_outdated(self) -> None:
        while len(self._frames) > 1 and self._seconds_until_due(self._frames[1]) == 0.0:
            self._frames.popleft()
            self._dropped += 1

    def _due_s(self, frame: RgbdFrame) -> float:
        return self._start_s + self._offsets_s[frame.seq]

    def _seconds_until_due(self, frame: RgbdFrame) -> float:
        """Return the seconds until a frame is due; before the start, the longest timeout."""
        return min(max(0.0, self._due_s(frame) - self._clock()), threading.TIMEOUT_MAX)


class FrameReader:
    """Reads the frames of one recording, in any order; in their order is fastest.

    Raises:
        InputError: The depth camera does not look where the color camera does.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        camera = recording.calibration
        self._pinhole, self._depth_factor = camera.pinhole, camera.depth_factor
        self._undistorter = Undistorter(self._pinhole, camera.distortion)
        self._register: Callable[[DepthImage], DepthImage] = self._undistorter.undistort_depth
        if recording.depth_camera is not None:
            registration = SoftwareRegistration(
                self._pinhole, recording.depth_camera, camera.depth_factor
            )
            self._register = registration.register
            self._depth_factor = registration.depth_factor

    def read(self, pair: FramePair, seq: int) -> RgbdFrame:
        """Load one pair and make its frame.

        Raises:
            UnreadableFrameError: If an image cannot be read.
        """
        recording, camera = self._recording, self._recording.calibration
        color, depth = pair.load(recording.image_size, recording.depth_size)
        return RgbdFrame(
            seq=seq,
            stamp_s=pair.color.stamp_s,
            receive_time_s=time.monotonic(),
            color_bgr=self._undistorter.undistort_color(color),
            depth_raw=self._register(depth),
            depth_factor=self._depth_factor,
            camera=self._pinhole,
            skew_s=pair.skew_s + camera.depth_offset_s,
            gravity_m_s2=recording.gravity_at(pair.color.stamp_s),
            accelerometer=recording.accelerometer.newest_at(pair.color.stamp_s),
            readout_s=camera.readout_s,
            timing_prior=camera.timing_prior,
        )
