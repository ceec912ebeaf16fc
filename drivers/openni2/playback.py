"""A recording that is open: its frames, one after another."""

import logging
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from drivers.camera import CameraCounters, EndOfStream, Pace, RgbdFrame
from drivers.openni2.images import TornFrameError
from drivers.openni2.library import OpenNI2
from drivers.openni2.optics import CameraChoice, make_optics
from drivers.openni2.pace import make_pacer
from drivers.openni2.pair_reader import PairReader
from drivers.openni2.player import OniPlayer
from drivers.openni2.recording import read_index

_log = logging.getLogger(__name__)


class Playback:
    """Made when a recording is opened, gone when it is closed."""

    def __init__(
        self, openni2: OpenNI2, path: Path, choice: CameraChoice, pace: Pace, mirror: bool
    ) -> None:
        """Raises InputError for a file without use, or one that does not fit the camera file."""
        self.index = read_index(path)
        with ExitStack() as undo:
            player = OniPlayer(openni2, path)
            undo.callback(player.close)
            self.optics = make_optics(player.source(mirror), choice)
            player.start()
            self._player, self._undo = player, undo.pop_all()
        self._reader = PairReader(player, self.index)
        self._pacer = make_pacer(pace, [self.index.stamp_s(i) for i, _ in self.index.pairs])
        self._next_seq = 0
        self.counters = CameraCounters()

    def read(self, timeout_s: float) -> RgbdFrame:
        """The next frame. Raises NoFrameYet, EndOfStream, CameraError as the contract says."""
        deadline_s = time.monotonic() + timeout_s
        while self._next_seq < len(self.index.pairs):
            seq = self._pacer.take(self._next_seq, deadline_s - time.monotonic())
            try:
                frame = self._frame(seq, deadline_s)
            except TornFrameError as error:
                _log.warning("frame %d is skipped: %s", seq, error)
                self._move_on(seq, skipped=1)
            else:
                self._move_on(seq, delivered=1)
                return frame
        # At the end of the file the library's thread would spin on one core.
        self._player.stop()
        raise EndOfStream

    def close(self) -> None:
        """Stop and release everything. May be called twice."""
        self._undo.close()

    def _frame(self, seq: int, deadline_s: float) -> RgbdFrame:
        colour, depth = self._reader.pair(seq, deadline_s)
        pair = self.index.pairs[seq]
        return RgbdFrame(
            seq=seq,
            stamp_s=self.index.stamp_s(pair[0]),
            arrival_s=time.monotonic(),
            colour_bgr=self.optics.colour(colour),
            depth_raw=self.optics.depth(depth),
            depth_factor=self.optics.depth_factor,
            camera=self.optics.camera,
            skew_s=self.index.skew_s(pair) + self.optics.depth_offset_s,
            readout_s=self.optics.readout_s,
        )

    def _move_on(self, seq: int, delivered: int = 0, skipped: int = 0) -> None:
        now = self.counters
        self.counters = replace(
            now,
            delivered=now.delivered + delivered,
            dropped=now.dropped + seq - self._next_seq,
            skipped=now.skipped + skipped,
        )
        self._next_seq = seq + 1
