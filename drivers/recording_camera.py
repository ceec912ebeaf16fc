"""Recordings: their formats, how they are opened, and their replay as a camera.

A thread decodes ahead of the reader, into a buffer that depends on the playback mode.
"""

import logging
import math
import threading
import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path

from drivers.calibration import SoftwareRegistration, Undistorter
from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    EndOfStream,
    FrameTimeout,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraError, InputError
from drivers.core.geometry import Trajectory
from drivers.layouts import open_folder
from drivers.plausibility import PlausibilityCheck
from drivers.recording.bag_names import is_bag_file
from drivers.recording.depth_enlargement import enlarge
from drivers.recording.image_decoding import DepthImage, UnreadableFrameError
from drivers.recording.recorded_frames import FramePair
from drivers.recording.recording import ImageTopics, Recording

_log = logging.getLogger(__name__)


class RecordingFormat(StrEnum):
    """The kinds of recordings, as in camera sources."""

    TUM = "tum"  # a folder of images, in TUM format or another benchmark's layout
    BAG = "bag"  # MCAP, a ROS 2 bag or a ROS 1 bag


def recording_format(path: Path) -> RecordingFormat:
    """Tell the format of a recording, which need not exist, by its suffix and its files."""
    if not path.is_dir():
        return RecordingFormat.BAG if is_bag_file(path.name) else RecordingFormat.TUM
    if (path / "metadata.yaml").exists():
        return RecordingFormat.BAG
    names = set[str]()
    with suppress(PermissionError):  # which opening reports
        names = {each.name for each in path.iterdir()}
    # A ROS 2 bag that was cut off has no metadata; a TUM folder may have a bag beside its lists.
    is_tum = not names.isdisjoint(("rgb.txt", "associations.txt"))
    return (
        RecordingFormat.BAG if any(map(is_bag_file, names)) and not is_tum else RecordingFormat.TUM
    )


def open_recording(
    path: Path, camera_file: Path | None = None, topics: ImageTopics | None = None
) -> Recording:
    """Open and check a recording, load its first frame, and log what is wrong with its clock.

    Args:
        path: A folder in TUM format or another benchmark's layout, an MCAP file, a bag of ROS 1 or
            ROS 2, the folder of a bag, or the files of a split bag joined by commas.
        camera_file: Camera file; None for the recording's own.
        topics: The topics of the color and the depth images in a bag; None to find them.

    Raises:
        InputError: The recording cannot be used, or the packages for its format are missing.
    """
    if recording_format(path) is RecordingFormat.TUM:
        if topics is not None:
            raise InputError(f"{path}: is a folder, which has no topics; leave out --topics")
        return open_folder(path, camera_file)
    check_bag_packages(path)
    from drivers.bag.bag_reader import open_bag  # its packages are optional

    recording = open_bag(path, camera_file, topics)
    if recording.warning:
        _log.warning("%s", recording.warning)
    return recording


def check_bag_packages(path: Path) -> None:
    """Raise InputError if the packages that a bag needs are not installed."""
    try:
        import mcap  # noqa: F401
        import rosbags  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: MCAP files and ROS bags need the package {error.name}; "
            "run: pip install 'kinect-vo[bags]'"
        ) from error


MAX_BUFFERED_FRAMES = 4
JOIN_TIMEOUT_S = 5.0
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
        self._register: Callable[[DepthImage], DepthImage] = self._undistort_enlarged
        if recording.depth_camera is not None:
            registration = SoftwareRegistration(
                self._pinhole, recording.depth_camera, camera.depth_factor
            )
            self._register = registration.register
            self._depth_factor = registration.depth_factor

    def _undistort_enlarged(self, depth: DepthImage) -> DepthImage:
        factor = self._recording.depth_enlargement
        return self._undistorter.undistort_depth(enlarge(depth, factor))

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


def log_implausible(recording: Recording) -> None:
    """Log what is implausible in the first, the middle and the last frame of a recording."""
    check, reader, pairs = (
        PlausibilityCheck(recording),
        FrameReader(recording),
        recording.frames.pairs,
    )
    for index in sorted({0, len(pairs) // 2, len(pairs) - 1}):
        try:
            check.examine(reader.read(pairs[index], index))
        except UnreadableFrameError:  # whoever reads all frames reports it
            continue


class RecordingCamera(RgbdCamera):
    """Replays a recording; a thread of its own decodes ahead of the reader.

    A frame that cannot be read is skipped, counted and logged, except the first one.

    Args:
        path: The recording, see `open_recording`.
        camera_file: Camera file; None to find one, see `find_calibration`.
        playback_mode: Lockstep or realtime.
        topics: See `open_recording`.
    """

    clock = Clock.RECORDED
    reconnects = True  # a recording is never lost

    def __init__(
        self,
        path: Path,
        camera_file: Path | None = None,
        playback_mode: PlaybackMode = PlaybackMode.LOCKSTEP,
        topics: ImageTopics | None = None,
    ) -> None:
        self.name = f"{recording_format(path)}:{path}"
        self._path, self._camera_file, self._topics = path, camera_file, topics
        self._playback_mode = playback_mode
        self._opened: Recording | None = None
        self._pairs: Sequence[FramePair] = ()
        self._thread = threading.Thread()
        self._buffer: FrameBuffer = LockstepBuffer()
        self._buffer.close()

    def open(self) -> None:
        """Check the recording and start decoding.

        Raises:
            InputError: If the recording cannot be used.
        """
        self.close()
        self._opened = open_recording(self._path, self._camera_file, self._topics)
        if self._opened.summary:
            _log.info("%s", self._opened.summary)
        self._pairs = self._opened.frames.pairs
        self._buffer = _make_buffer(self._playback_mode, self._pairs, self.counters)
        self._thread = threading.Thread(
            target=_decode_ahead,
            args=(self._pairs, self._opened, self._buffer),
            name="recording-decode",
            daemon=True,
        )
        self._thread.start()

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame, see `RgbdCamera.read`."""
        return self._buffer.get(timeout_s)

    def close(self) -> None:
        """Stop decoding. The counters remain valid."""
        self._buffer.close()
        if self._thread.is_alive():
            # A read from a dead network disk can hang; the thread is then abandoned.
            self._thread.join(JOIN_TIMEOUT_S)
        if self._opened and not self._thread.is_alive():
            self._opened.close()

    @property
    def counters(self) -> CameraCounters:
        return self._buffer.counters

    @property
    def status(self) -> CameraStatus:
        if self._opened is None:
            return CameraStatus(CameraState.OPENING)
        has_frame = self.counters.delivered > 0
        return CameraStatus(CameraState.STREAMING if has_frame else CameraState.STARTING)

    @property
    def intrinsics_source(self) -> str:
        """The camera file or topic; "" before `open`."""
        return self._opened.intrinsics_source if self._opened else ""

    @property
    def depth_unit_source(self) -> str:
        """The camera file or topic; "" for depth in meters, and before `open`."""
        return self._opened.depth_unit_source if self._opened else ""

    @property
    def frame_count(self) -> int | None:
        """The number of pairs; None before `open`."""
        return len(self._pairs) if self._opened else None

    @property
    def unpaired(self) -> int | None:
        """The number of images without a partner within 20 ms; None before `open`."""
        return self._opened.frames.unpaired if self._opened else None

    @property
    def recording(self) -> Recording:
        """The recording. Raises CameraError before `open`."""
        if self._opened is None:
            raise CameraError(NOT_OPEN)
        return self._opened

    @property
    def ground_truth(self) -> Trajectory | None:
        """The true poses, if the recording has them; None before `open`."""
        return self._opened.ground_truth if self._opened else None


def _make_buffer(
    playback_mode: PlaybackMode, pairs: Sequence[FramePair], earlier_counters: CameraCounters
) -> FrameBuffer:
    if playback_mode is PlaybackMode.LOCKSTEP:
        return LockstepBuffer(earlier_counters)
    return RealtimeBuffer(playback_offsets_s(pairs), earlier_counters)


def playback_offsets_s(pairs: Sequence[FramePair]) -> list[float]:
    """Return when to deliver each frame; after a jump back of the clock playback goes on."""
    offsets_s = [0.0]
    start_s = pairs[0].color.stamp_s
    for before, pair in pairwise(pairs):
        if pair.color.stamp_s < before.color.stamp_s:
            start_s = pair.color.stamp_s - offsets_s[-1]
        offsets_s.append(pair.color.stamp_s - start_s)
    return offsets_s


def _decode_ahead(pairs: Sequence[FramePair], recording: Recording, buffer: FrameBuffer) -> None:
    """Body of the decoding thread. Its errors reach the reader."""
    try:
        _fill_buffer(buffer, pairs, recording)
        buffer.finish(EndOfStream())
    except BufferClosedError:
        pass
    except Exception as error:
        buffer.finish(error)


def _fill_buffer(buffer: FrameBuffer, pairs: Sequence[FramePair], recording: Recording) -> None:
    reader = FrameReader(recording)
    index = 0
    while (index := buffer.next_index(index)) < len(pairs):
        try:
            frame = reader.read(pairs[index], seq=index)
        except UnreadableFrameError as error:
            _log.warning("frame %d is skipped: %s", index, error)
            buffer.count_skipped()
        else:
            buffer.put(frame)
        index += 1
