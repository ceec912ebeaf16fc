"""The plain chessboard: the whole of it must be in the image."""

from dataclasses import dataclass

import cv2
import numpy as np

from drivers.geometry import Array
from vo_service.calibration.board import NO_CORNERS, Corners, GreyImage, Layout

# Refinement looks at windows of up to 11 x 11 pixels, less where corners are close together.
LARGEST_HALF_WINDOW_PX = 5
SMALLEST_SPACING_PX = 6.0
REFINED = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
FIND = cv2.CALIB_CB_NORMALIZE_IMAGE
# From here the finder grows the board as far as it goes.
SMALLEST = (3, 3)


@dataclass(frozen=True)
class Chessboard:
    """Black and white squares, nothing else."""

    layout: Layout

    @property
    def name(self) -> str:
        """With the inner corners, as the option has them."""
        columns, rows = self._corners
        return f"chessboard of {columns}x{rows} inner corners"

    def find(self, grey: GreyImage) -> Corners:
        """All inner corners or none."""
        found, pixels = cv2.findChessboardCornersSB(grey, self._corners, flags=FIND)
        if not found:
            return NO_CORNERS
        columns, rows = self._corners
        grid = pixels.reshape(rows, columns, 2).astype(np.float64)
        spacing_px = min(_spacing_px(grid), _spacing_px(grid.transpose(1, 0, 2)))
        if spacing_px < SMALLEST_SPACING_PX:
            return NO_CORNERS
        half = int(min(LARGEST_HALF_WINDOW_PX, spacing_px / 2 - 1))
        # Better than the finder's own fraction of a pixel, which is that of a fitted grid.
        refined = cv2.cornerSubPix(grey, pixels, (half, half), (-1, -1), REFINED)
        return Corners(refined.reshape(-1, 2).astype(np.float64), self.layout.inner_corners_m)

    def seen_instead(self, grey: GreyImage) -> str:
        """A chessboard of any other size."""
        flags = FIND | cv2.CALIB_CB_LARGER
        found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, SMALLEST, flags)
        if not found or meta.shape[:2] in (self._corners, self._corners[::-1]):
            return ""
        rows, columns = sorted(meta.shape[:2])
        return f"chessboard:{columns}x{rows}"

    def dark_cells_m(self) -> Array:
        """Every other square, the first one among them."""
        side = self.layout.square_m
        cells = [
            (column * side, row * side, side, side)
            for row in range(self.layout.rows)
            for column in range(row % 2, self.layout.columns, 2)
        ]
        return np.array(cells)

    @property
    def _corners(self) -> tuple[int, int]:
        return self.layout.columns - 1, self.layout.rows - 1


def _spacing_px(grid: Array) -> float:
    """The least distance between neighbours along the second axis of (rows, columns, 2)."""
    return float(np.linalg.norm(np.diff(grid, axis=1), axis=2).min())
