"""Colour and depth that belong together, out of a file in which they lie apart."""

import time

import numpy as np
from numpy.typing import NDArray

from drivers.openni2.images import TornFrameError, colour_of, depth_of
from drivers.openni2.library import Sensor
from drivers.openni2.player import OniPlayer
from drivers.openni2.recording import Index


class PairReader:
    """Goes through a recording once, and keeps an image until its partner is there."""

    def __init__(self, player: OniPlayer, index: Index) -> None:
        self._player, self._index = player, index
        self._seq_of = {at: seq for seq, pair in enumerate(index.pairs) for at in pair}
        self._position = 0
        self._colours: dict[int, NDArray[np.uint8]] = {}
        self._depths: dict[int, NDArray[np.uint16]] = {}
        self._torn: dict[int, TornFrameError] = {}

    def pair(self, seq: int, deadline_s: float) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Colour (height, width, 3) BGR and depth (height, width) of pair `seq`.

        Pairs before it can no longer be had. Raises NoFrameYet at `deadline_s` (CLOCK_MONOTONIC),
        TornFrameError if one of the two images is not whole, CameraError if the library does not
        play the file as it should.
        """
        last = max(self._index.pairs[seq])
        while self._position <= last:
            self._read(seq, deadline_s)
        self._forget_before(seq)
        if seq in self._torn:
            raise self._torn[seq]
        return self._colours[seq], self._depths[seq]

    def _read(self, wanted: int, deadline_s: float) -> None:
        """Play the next image; keep it if pair `wanted` or a later one needs it."""
        seq = self._seq_of.get(self._position, -1)
        expected = self._index.images[self._position]
        self._player.wait(expected, deadline_s - time.monotonic())
        with self._player.image(expected) as frame:
            try:
                if seq >= wanted and frame.sensor == Sensor.COLOUR:
                    self._colours[seq] = colour_of(frame)
                elif seq >= wanted:
                    self._depths[seq] = depth_of(frame)
            except TornFrameError as error:
                self._torn[seq] = error
        self._position += 1
        if self._position == len(self._index.images):
            self._player.stop()

    def _forget_before(self, wanted: int) -> None:
        for kept in (self._colours, self._depths, self._torn):
            for seq in [seq for seq in kept if seq < wanted]:
                del kept[seq]
