"""A recording as a camera: a thread decodes ahead of the reader."""

import logging
import threading
from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    EndOfStream,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraError
from drivers.core.geometry import Trajectory
from drivers.pacing import LockstepPacer, make_pacer
from drivers.playback.frame_buffer import NOT_OPEN, BufferClosedError, FrameBuffer
from drivers.playback.frame_reader import FrameReader
from drivers.playback.recording_formats import (
    open_recording,
    read_recorded_odometry,
    recording_format,
)
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.recorded_frames import FramePair
from drivers.recording.recording import ImageTopics, Recording

_log = logging.getLogger(__name__)

JOIN_TIMEOUT_S = 5.0


class RecordingCamera(RgbdCamera):
    """Replays a recording; a thread of its own decodes ahead of the reader.

    A frame that cannot be read is skipped, counted and logged, except the first one.

    Args:
        path: The recording, see `open_recording`.
        camera_file: Camera file; None to find one, see `find_calibration`.
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
        self._buffer = FrameBuffer(LockstepPacer())
        self._buffer.close()

    def open(self) -> None:
        """Check the recording and start decoding. Raises InputError."""
        self.close()
        self._opened = open_recording(self._path, self._camera_file, self._topics)
        if self._opened.summary:
            _log.info("%s", self._opened.summary)
        self._pairs = self._opened.frames.pairs
        offsets_s = playback_offsets_s(self._pairs)
        pacer = make_pacer(self._playback_mode, offsets_s.__getitem__, len(offsets_s))
        self._buffer = FrameBuffer(pacer, self.counters)
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
    def recording(self) -> Recording:
        """The recording. Raises CameraError before `open`."""
        if self._opened is None:
            raise CameraError(NOT_OPEN)
        return self._opened

    @property
    def ground_truth(self) -> Trajectory | None:
        """The true poses, if the recording has them; None before `open`."""
        return self._opened.ground_truth if self._opened else None

    def recorded_odometry(self, topics: Collection[str]) -> Iterator[bytes]:
        return read_recorded_odometry(self._path, topics)


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
