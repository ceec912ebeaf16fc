"""Recordings: their formats, how they are opened, and their replay as a camera."""

import logging
import threading
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

from drivers.camera import CameraCounters, Clock, EndOfStream, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core import CameraError, InputError
from drivers.core.geometry import Trajectory
from drivers.recording import FramePair, ImageTopics, Recording, UnreadableFrameError
from drivers.recording.prefetch import (
    NOT_OPEN,
    BufferClosedError,
    FrameBuffer,
    FrameReader,
    LockstepBuffer,
    RealtimeBuffer,
)
from drivers.tum import open_tum_folder

BAG_SUFFIXES = (".mcap", ".bag", ".db3")


class RecordingFormat(StrEnum):
    """The kinds of recordings, as in camera sources."""

    TUM = "tum"  # a folder of images and lists
    BAG = "bag"  # MCAP, a ROS 2 bag or a ROS 1 bag


def recording_format(path: Path) -> RecordingFormat:
    """Tell the format of a recording, which need not exist, by its suffix and its files."""
    if path.suffix.lower() in BAG_SUFFIXES and not path.is_dir():
        return RecordingFormat.BAG
    if (path / "metadata.yaml").exists():
        return RecordingFormat.BAG
    names = {each.name for each in path.iterdir()} if path.is_dir() else set()
    # A ROS 2 bag that was cut off has no metadata; a TUM folder may have a bag beside its lists.
    is_tum = not names.isdisjoint(("rgb.txt", "associations.txt"))
    is_cut_off = any(name.endswith((".mcap", ".db3")) for name in names) and not is_tum
    return RecordingFormat.BAG if is_cut_off else RecordingFormat.TUM


def open_recording(
    path: Path, camera_file: Path | None = None, topics: ImageTopics | None = None
) -> Recording:
    """Open and check a recording, and load its first frame.

    Args:
        path: A folder in TUM format, an MCAP file, a ROS 2 bag (folder or .db3) or a ROS 1 bag.
        camera_file: Camera file; None for the recording's own.
        topics: The topics of the color and the depth images in a bag; None to find them.

    Raises:
        InputError: The recording cannot be used, or the packages for its format are missing.
    """
    if recording_format(path) is RecordingFormat.TUM:
        if topics is not None:
            raise InputError(f"{path}: is a folder, which has no topics; leave out --topics")
        return open_tum_folder(path, camera_file)
    check_bag_packages(path)
    from drivers.bag import open_bag  # its packages are optional

    return open_bag(path, camera_file, topics)


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


_log = logging.getLogger(__name__)
JOIN_TIMEOUT_S = 5.0


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
    first_s = pairs[0].color.stamp_s
    return RealtimeBuffer([pair.color.stamp_s - first_s for pair in pairs], earlier_counters)


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
