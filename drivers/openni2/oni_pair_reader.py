"""Reading of color and depth pairs that are not adjacent in the file."""

import time

import numpy as np
from numpy.typing import NDArray

from drivers.openni2.decode import IncompleteFrameError, decode_color, decode_depth
from drivers.openni2.library import SensorType
from drivers.openni2.oni_index import OniIndex
from drivers.openni2.oni_player import OniPlayer


class OniPairReader:
    """Reads a recording once from start to end, and keeps an image until its partner is read."""

    def __init__(self, player: OniPlayer, index: OniIndex) -> None:
        self._player, self._index = player, index
        self._seq_of_image = {i: seq for seq, pair in enumerate(index.pairs) for i in pair}
        self._position = 0
        self._colors: dict[int, NDArray[np.uint8]] = {}
        self._depths: dict[int, NDArray[np.uint16]] = {}
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
        self._discard_before(seq)
        if seq in self._incomplete:
            raise self._incomplete[seq]
        return self._colors[seq], self._depths[seq]

    def _read_image(self, min_seq: int, deadline_s: float) -> None:
        """Play the next image; keep it if it belongs to pair `min_seq` or a later one."""
        seq = self._seq_of_image.get(self._position, -1)
        expected = self._index.images[self._position]
        self._player.wait_for_image(expected, deadline_s - time.monotonic())
        with self._player.read_image(expected) as frame:
            try:
                if seq >= min_seq and frame.sensor == SensorType.COLOR:
                    self._colors[seq] = decode_color(frame)
                elif seq >= min_seq:
                    self._depths[seq] = decode_depth(frame)
            except IncompleteFrameError as error:
                self._incomplete[seq] = error
        self._position += 1
        if self._position == len(self._index.images):
            self._player.stop()

    def _discard_before(self, min_seq: int) -> None:
        for by_seq in (self._colors, self._depths, self._incomplete):
            for seq in [seq for seq in by_seq if seq < min_seq]:
                del by_seq[seq]
