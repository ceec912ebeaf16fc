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
SEGMENT_FRAMES = 32
MAX_SEGMENTS = 8
# A longer time without a frame ends a piece.
MAX_GAP_S = 0.11
# Images are shrunk to this before their shift is measured.
THUMBNAIL_SIZE_PX = (80, 60)


@dataclass(frozen=True)
class MotionSegment:
    """Frames that follow one another.

    shake_rad_s  standard deviation of the speed at which the image moves
    """

    frames: tuple[RgbdFrame, ...]
    speed_sigma_rad_s: float


class FastestSegments:
    """Takes a film frame by frame and keeps its briskest pieces."""

    def __init__(self) -> None:
        self.segments: list[MotionSegment] = []
        self.frame_count = 0
        self._frames: list[RgbdFrame] = []
        self._speeds_rad_s: list[Array] = []
        self._thumbnail = np.zeros(THUMBNAIL_SIZE_PX[::-1], np.float32)
        self._window = cv2.createHanningWindow(THUMBNAIL_SIZE_PX, cv2.CV_32F)

    @property
    def speed_sigma_rad_s(self) -> float:
        """Of the briskest piece so far."""
        return self.segments[0].speed_sigma_rad_s if self.segments else 0.0

    def process(self, frame: RgbdFrame) -> None:
        """Look at the next frame."""
        self.frame_count += 1
        small = _make_thumbnail(frame)
        duration_s = frame.stamp_s - self._frames[-1].stamp_s if self._frames else 0.0
        if not 0.0 < duration_s <= MAX_GAP_S:
            self._start_segment()
        if self._frames:
            shift, _ = cv2.phaseCorrelate(self._thumbnail, small, self._window)
            scale = np.array([frame.camera.width, frame.camera.height]) / THUMBNAIL_SIZE_PX
            self._speeds_rad_s.append(scale * shift / (frame.camera.fx * duration_s))
        self._frames.append(frame)
        self._thumbnail = small
        if len(self._frames) == SEGMENT_FRAMES:
            self._finish_segment()
            self._start_segment()

    def _finish_segment(self) -> None:
        shake_rad_s = float(np.sqrt(np.var(self._speeds_rad_s, axis=0).sum()))
        pieces = [*self.segments, MotionSegment(tuple(self._frames), shake_rad_s)]
        self.segments = sorted(pieces, key=lambda piece: -piece.speed_sigma_rad_s)[:MAX_SEGMENTS]

    def _start_segment(self) -> None:
        self._frames, self._speeds_rad_s = [], []


def _make_thumbnail(frame: RgbdFrame) -> Array:
    small = cv2.resize(frame.color_bgr, THUMBNAIL_SIZE_PX, interpolation=cv2.INTER_AREA)
    grey: Array = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return grey
