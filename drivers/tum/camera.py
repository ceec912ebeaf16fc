"""A recorded TUM folder as a camera."""

import logging
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from drivers.camera import CameraCounters, Clock, EndOfStream, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core.errors import InputError
from drivers.core.trajectory import Trajectory
from drivers.rectify import make_undistorter
from drivers.tum.folder import TumFolder, UnreadableFrameError, load_pair, open_tum_folder
from drivers.tum.index_files import FramePair
from drivers.tum.prefetch import BufferClosedError, FrameBuffer, LockstepBuffer, RealtimeBuffer

_log = logging.getLogger(__name__)
JOIN_TIMEOUT_S = 5.0


class TumFrameReader:
    """Reads the frames of one folder, in any order."""

    def __init__(self, folder: TumFolder) -> None:
        self._folder = folder
        camera = folder.calibration
        self._pinhole = camera.pinhole
        self._undistorter = make_undistorter(self._pinhole, camera.distortion)

    def read(self, pair: FramePair, seq: int) -> RgbdFrame:
        """Load, undistort and stamp one pair.

        Raises:
            UnreadableFrameError: If an image cannot be read.
        """
        camera = self._folder.calibration
        color, depth = load_pair(pair, (camera.width, camera.height))
        return RgbdFrame(
            seq=seq,
            stamp_s=pair.color.stamp_s,
            receive_time_s=time.monotonic(),
            color_bgr=self._undistorter.undistort_color(color),
            depth_raw=self._undistorter.undistort_depth(depth),
            depth_factor=camera.depth_factor,
            camera=self._pinhole,
            skew_s=pair.skew_s + camera.depth_offset_s,
            gravity_m_s2=self._folder.gravity.mean_at(pair.color.stamp_s),
            readout_s=camera.readout_s,
            timing_prior=camera.timing_prior,
        )


class TumCamera(RgbdCamera):
    """Replays a folder; a thread of its own decodes ahead of the reader.

    A frame that cannot be read is skipped, counted and logged, except the first one.

    Args:
        folder: The recording.
        camera_file: Camera file; None to find one, see `find_calibration`.
        playback_mode: Lockstep or realtime.
        every: Use only every n-th pair; `seq` counts the used pairs.
    """

    clock = Clock.RECORDED

    def __init__(
        self,
        folder: Path,
        camera_file: Path | None = None,
        playback_mode: PlaybackMode = PlaybackMode.LOCKSTEP,
        every: int = 1,
    ) -> None:
        if every < 1:
            raise InputError(f"every {every}: must be 1 (each frame) or more")
        self.name = f"tum:{folder}"
        self._folder, self._camera_file = folder, camera_file
        self._playback_mode, self._every = playback_mode, every
        self._opened: TumFolder | None = None
        self._pairs: Sequence[FramePair] = ()
        self._thread = threading.Thread()
        self._buffer: FrameBuffer = LockstepBuffer()
        self._buffer.close()

    def open(self) -> None:
        """Check the folder and start decoding.

        Raises:
            InputError: If the folder cannot be used.
        """
        self.close()
        self._opened = open_tum_folder(self._folder, self._camera_file)
        self._pairs = self._opened.frames.pairs[:: self._every]
        self._buffer = _make_buffer(self._playback_mode, self._pairs, self.counters)
        self._thread = threading.Thread(
            target=_decode_ahead,
            args=(self._pairs, self._opened, self._buffer),
            name="tum-decode",
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

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`."""
        return self._buffer.counters

    @property
    def frame_count(self) -> int | None:
        """The number of used pairs; None before `open`."""
        return len(self._pairs) if self._opened else None

    @property
    def unpaired(self) -> int | None:
        """The number of images without a partner within 20 ms; None before `open`."""
        return self._opened.frames.unpaired if self._opened else None

    @property
    def ground_truth(self) -> Trajectory | None:
        """The poses of FOLDER/groundtruth.txt, if it exists; None before `open`."""
        return self._opened.ground_truth if self._opened else None


def _make_buffer(
    playback_mode: PlaybackMode, pairs: Sequence[FramePair], earlier_counters: CameraCounters
) -> FrameBuffer:
    if playback_mode is PlaybackMode.LOCKSTEP:
        return LockstepBuffer(earlier_counters)
    first_s = pairs[0].color.stamp_s
    return RealtimeBuffer([pair.color.stamp_s - first_s for pair in pairs], earlier_counters)


def _decode_ahead(pairs: Sequence[FramePair], folder: TumFolder, buffer: FrameBuffer) -> None:
    """Body of the decoding thread. Its errors reach the reader."""
    try:
        _fill_buffer(buffer, pairs, folder)
        buffer.finish(EndOfStream())
    except BufferClosedError:
        pass
    except Exception as error:
        buffer.finish(error)


def _fill_buffer(buffer: FrameBuffer, pairs: Sequence[FramePair], folder: TumFolder) -> None:
    reader = TumFrameReader(folder)
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
