"""Raw images of both cameras, and views of a board in them."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.tools.calibration.board import BoardCorners, GrayImage

NO_DEPTH: NDArray[np.uint16] = np.zeros((0, 0), np.uint16)


@dataclass(frozen=True)
class Snapshot:
    """Raw images of both cameras at one time.

    Attributes:
        name: Name for people: a file, or the number of a frame.
        stamp_s: Time on any clock.
        color_bgr: (height, width, 3) uint8, distorted.
        depth_raw: (height, width) uint16, not registered; NO_DEPTH without depth.
    """

    name: str
    stamp_s: float
    color_bgr: NDArray[np.uint8]
    depth_raw: NDArray[np.uint16]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the color image."""
        return self.color_bgr.shape[1], self.color_bgr.shape[0]

    @property
    def gray(self) -> GrayImage:
        """(height, width) uint8 brightness."""
        gray: GrayImage = cv2.cvtColor(self.color_bgr, cv2.COLOR_BGR2GRAY)  # type: ignore[assignment]
        return gray


@dataclass(frozen=True)
class BoardView:
    """Snapshot of the board, without its color image."""

    name: str
    size: tuple[int, int]
    corners: BoardCorners
    depth_raw: NDArray[np.uint16]
