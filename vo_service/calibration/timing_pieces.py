"""The pieces of a film in which the camera was shaken most: they tell its timing best.

At one speed a rolling shutter bends all images alike, which nothing in them tells. So what counts
is how much the speed changes within a piece.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array

# Frames of a piece, and how many pieces are kept.
PIECE_FRAMES = 32
PIECES = 8
# A longer time without a frame ends a piece.
LONGEST_GAP_S = 0.11
# Images are shrunk to this before their shift is measured.
SMALL_PX = (80, 60)


@dataclass(frozen=True)
class Piece:
    """Frames that follow one another.

    shake_rad_s  standard deviation of the speed at which the image moves
    """

    frames: tuple[RgbdFrame, ...]
    shake_rad_s: float


class BriskestPieces:
    """Takes a film frame by frame and keeps its briskest pieces."""

    def __init__(self) -> None:
        self.kept: list[Piece] = []
        self.seen = 0
        self._frames: list[RgbdFrame] = []
        self._speeds_rad_s: list[Array] = []
        self._small = np.zeros(SMALL_PX[::-1], np.float32)
        self._window = cv2.createHanningWindow(SMALL_PX, cv2.CV_32F)

    @property
    def shake_rad_s(self) -> float:
        """Of the briskest piece so far."""
        return self.kept[0].shake_rad_s if self.kept else 0.0

    def offer(self, frame: RgbdFrame) -> None:
        """Look at the next frame."""
        self.seen += 1
        small = _shrunk(frame)
        duration_s = frame.stamp_s - self._frames[-1].stamp_s if self._frames else 0.0
        if not 0.0 < duration_s <= LONGEST_GAP_S:
            self._begin()
        if self._frames:
            shift, _ = cv2.phaseCorrelate(self._small, small, self._window)
            scale = np.array([frame.camera.width, frame.camera.height]) / SMALL_PX
            self._speeds_rad_s.append(scale * shift / (frame.camera.fx * duration_s))
        self._frames.append(frame)
        self._small = small
        if len(self._frames) == PIECE_FRAMES:
            self._keep()
            self._begin()

    def _keep(self) -> None:
        shake_rad_s = float(np.sqrt(np.var(self._speeds_rad_s, axis=0).sum()))
        pieces = [*self.kept, Piece(tuple(self._frames), shake_rad_s)]
        self.kept = sorted(pieces, key=lambda piece: -piece.shake_rad_s)[:PIECES]

    def _begin(self) -> None:
        self._frames, self._speeds_rad_s = [], []


def _shrunk(frame: RgbdFrame) -> Array:
    small = cv2.resize(frame.colour_bgr, SMALL_PX, interpolation=cv2.INTER_AREA)
    grey: Array = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return grey
