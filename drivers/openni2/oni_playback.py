"""Playback of an open .oni recording, frame by frame."""

import logging
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from drivers.camera import CameraCounters, EndOfStream, PlaybackMode, RgbdFrame
from drivers.openni2.decode import IncompleteFrameError
from drivers.openni2.library import OpenNI2
from drivers.openni2.oni_index import read_oni_index
from drivers.openni2.oni_pair_reader import OniPairReader
from drivers.openni2.oni_player import OniPlayer
from drivers.openni2.rectify import CalibrationFile, make_rectifier
from drivers.playback import make_playback_scheduler

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
    ) -> None:

        self.index = read_oni_index(path)
        with ExitStack() as undo:
            player = OniPlayer(openni2, path)
            undo.callback(player.close)
            self.rectifier = make_rectifier(player.read_properties(mirror), calibration_file)
            player.start()
            self._player, self._exit_stack = player, undo.pop_all()
        self._reader = OniPairReader(player, self.index)
        self._scheduler = make_playback_scheduler(
            playback_mode, [self.index.stamp_s(i) for i, _ in self.index.pairs]
        )
        self._next_seq = 0
        self.counters = earlier_counters

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame. Raises FrameTimeout, EndOfStream, CameraError."""
        deadline_s = time.monotonic() + timeout_s
        while self._next_seq < len(self.index.pairs):
            seq = self._scheduler.wait_until_due(self._next_seq, deadline_s - time.monotonic())
            try:
                frame = self._make_frame(seq, deadline_s)
            except IncompleteFrameError as error:
                _log.warning("frame %d is skipped: %s", seq, error)
                self._advance(seq, skipped=1)
            else:
                self._advance(seq, delivered=1)
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

    def _advance(self, seq: int, delivered: int = 0, skipped: int = 0) -> None:
        counters = self.counters
        self.counters = replace(
            counters,
            delivered=counters.delivered + delivered,
            dropped=counters.dropped + seq - self._next_seq,
            skipped=counters.skipped + skipped,
        )
        self._next_seq = seq + 1
