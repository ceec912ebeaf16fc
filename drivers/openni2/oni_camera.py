"""An .oni recording as a camera."""

import logging
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import (
    CameraCounters,
    Clock,
    EndOfStream,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
    SensorConfig,
)
from drivers.core import CameraError
from drivers.openni2.bindings import OpenNI2, SensorType
from drivers.openni2.oni_index import OniIndex, read_oni_index
from drivers.openni2.oni_player import OniPlayer
from drivers.openni2.stream import IncompleteFrameError
from drivers.pacing import HOST_CLOCK, HostClock, make_pacer
from drivers.rectify import CalibrationFile, make_rectifier


class OniPairReader:
    """Reads a recording once from start to end, and keeps an image until its partner is read."""

    def __init__(self, player: OniPlayer, index: OniIndex) -> None:
        self._player, self._index = player, index
        self._seq_of_image = {i: seq for seq, pair in enumerate(index.pairs) for i in pair}
        self._position = 0
        self._images: dict[tuple[int, SensorType], NDArray[Any]] = {}
        self._incomplete: dict[int, IncompleteFrameError] = {}

    def read_pair(
        self, seq: int, deadline_s: float
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Read pair `seq`; earlier pairs are discarded.

        Returns:
            Color (height, width, 3) BGR uint8 and depth (height, width) uint16.

        Raises:
            FrameTimeout: The pair is not read by `deadline_s` (CLOCK_MONOTONIC).
            IncompleteFrameError: One of the two images is incomplete.
            CameraError: The library does not play the file in order.
        """
        last = max(self._index.pairs[seq])
        while self._position <= last:
            self._read_image(seq, deadline_s)
        self._images = {key: image for key, image in self._images.items() if key[0] >= seq}
        if seq in self._incomplete:
            raise self._incomplete.pop(seq)
        return self._images[seq, SensorType.COLOR], self._images[seq, SensorType.DEPTH]

    def _read_image(self, min_seq: int, deadline_s: float) -> None:
        """Play the next image; keep it if it belongs to pair `min_seq` or a later one."""
        seq = self._seq_of_image.get(self._position, -1)
        expected = self._index.images[self._position]
        self._player.wait_for_image(expected, deadline_s - time.monotonic())
        with self._player.read_image(expected) as frame:
            try:
                if seq >= min_seq:
                    self._images[seq, expected.sensor] = self._player.decode(frame)
            except IncompleteFrameError as error:
                self._incomplete[seq] = error
        self._position += 1
        if self._position == len(self._index.images):
            self._player.stop()


_log = logging.getLogger(__name__)


class OniPlayback:
    """One playback of a recording, from opening to closing it.

    Raises:
        InputError: The file cannot be used, or does not fit the camera file.
    """

    def __init__(
        self,
        openni2: OpenNI2,
        path: Path,
        calibration_file: CalibrationFile,
        playback_mode: PlaybackMode,
        mirror: bool,
        earlier_counters: CameraCounters,
        host: HostClock,
    ) -> None:
        self.index = read_oni_index(path)
        with ExitStack() as undo:
            player = OniPlayer(openni2, path, mirror)
            undo.callback(player.close)
            self.rectifier = make_rectifier(player.read_properties(), calibration_file)
            player.start()
            self._player, self._exit_stack = player, undo.pop_all()
        self._reader = OniPairReader(player, self.index)
        self._pacer = make_pacer(playback_mode, self._offset_s, len(self.index.pairs), host)
        self._next_seq = 0
        self.counters = earlier_counters

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame. Raises FrameTimeout, EndOfStream, CameraError."""
        deadline_s = time.monotonic() + timeout_s
        while self._next_seq < len(self.index.pairs):
            seq = self._pacer.wait_until_due(self._next_seq, deadline_s - time.monotonic())
            try:
                frame = self._make_frame(seq, deadline_s)
            except IncompleteFrameError as error:
                _log.warning("frame %d is skipped: %s", seq, error)
                self._advance(seq, CameraCounters(skipped=1))
            else:
                self._advance(seq, CameraCounters(delivered=1))
                return frame
        # At the end of the file the library's thread would keep one core busy.
        self._player.stop()
        raise EndOfStream

    def close(self) -> None:
        """Stop and release everything. May be called twice."""
        self._exit_stack.close()

    def _make_frame(self, seq: int, deadline_s: float) -> RgbdFrame:
        color, depth = self._reader.read_pair(seq, deadline_s)
        pair = self.index.pairs[seq]
        return RgbdFrame(
            seq=seq,
            stamp_s=self.index.stamp_s(pair[0]),
            receive_time_s=time.monotonic(),
            color_bgr=self.rectifier.rectify_color(color),
            depth_raw=self.rectifier.rectify_depth(depth),
            depth_factor=self.rectifier.depth_factor,
            camera=self.rectifier.camera,
            skew_s=self.index.skew_s(pair) + self.rectifier.depth_offset_s,
            readout_s=self.rectifier.readout_s,
            timing_prior=self.rectifier.timing_prior,
        )

    def _offset_s(self, seq: int) -> float:
        first, pair = self.index.pairs[0], self.index.pairs[seq]
        return self.index.stamp_s(pair[0]) - self.index.stamp_s(first[0])

    def _advance(self, seq: int, count: CameraCounters) -> None:
        self.counters += count + CameraCounters(dropped=seq - self._next_seq)
        self._next_seq = seq + 1


class OniCamera(RgbdCamera):
    """Plays a recording through libOpenNI2, on the reader's thread (see `drivers.openni2`).

    Stamps are the recording's own (usually microseconds since its start). Color and depth are
    paired by nearest stamp over the whole file, so both playback modes deliver the same frames.
    For the rule of registration see `drivers.rectify`. Of the settings only `mirror` is
    used; a mirrored recording is mirrored back unless it is set. A pair that cannot be read is
    skipped, counted and logged.
    """

    clock = Clock.RECORDED

    def __init__(
        self,
        path: Path,
        camera_file: Path | None = None,
        playback_mode: PlaybackMode = PlaybackMode.LOCKSTEP,
        settings: SensorConfig | None = None,
        host: HostClock = HOST_CLOCK,
    ) -> None:
        self.name = f"openni2:{path}"
        self._path, self._camera_file, self._playback_mode = path, camera_file, playback_mode
        self._mirror = (settings or SensorConfig()).mirror
        self._host = host
        self._openni2: OpenNI2 | None = None
        self._playback: OniPlayback | None = None
        self._is_open = False

    def open(self) -> None:
        """Check the file and start playback. Raises InputError."""
        self.close()
        calibration_file = CalibrationFile.read(self._camera_file)
        self._openni2 = self._openni2 or OpenNI2()
        self._playback = OniPlayback(
            self._openni2,
            self._path,
            calibration_file,
            self._playback_mode,
            self._mirror,
            self.counters,
            self._host,
        )
        self._is_open = True

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame, see `RgbdCamera.read`."""
        if self._playback is None or not self._is_open:
            raise CameraError(f"{self.name}: the recording is not open; open it first")
        return self._playback.read(timeout_s)

    def close(self) -> None:
        """Stop playback. The counters remain valid."""
        self._is_open = False
        if self._playback is not None:
            self._playback.close()

    @property
    def counters(self) -> CameraCounters:
        return self._playback.counters if self._playback else CameraCounters()

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; "" before `open`."""
        return self._playback.rectifier.intrinsics_source if self._playback else ""

    @property
    def frame_count(self) -> int | None:
        """The number of pairs of color and depth; None before `open`."""
        return len(self._playback.index.pairs) if self._playback else None
