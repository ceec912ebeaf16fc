"""The plain chessboard: the whole of it must be in the image."""

from dataclasses import dataclass

import cv2
import numpy as np

from drivers.core.geometry import Array
from vo_service.tools.calibration.board import NO_CORNERS, BoardCorners, BoardLayout, GrayImage

# Refinement looks at windows of up to 11 x 11 pixels, less where corners are close together.
MAX_HALF_WINDOW_PX = 5
MIN_SPACING_PX = 6.0
SUBPIXEL_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
FIND_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE
# From here the finder grows the board as far as it goes.
MIN_PATTERN = (3, 3)


@dataclass(frozen=True)
class Chessboard:
    """Black and white squares, nothing else."""

    layout: BoardLayout

    @property
    def name(self) -> str:
        """With the inner corners, as the option has them."""
        columns, rows = self._inner_corners
        return f"chessboard of {columns}x{rows} inner corners"

    def find_corners(self, gray: GrayImage) -> BoardCorners:
        """All inner corners or none."""
        found, pixels = cv2.findChessboardCornersSB(gray, self._inner_corners, flags=FIND_FLAGS)
        if not found:
            return NO_CORNERS
        columns, rows = self._inner_corners
        grid = pixels.reshape(rows, columns, 2).astype(np.float64)
        spacing_px = min(_min_spacing_px(grid), _min_spacing_px(grid.transpose(1, 0, 2)))
        if spacing_px < MIN_SPACING_PX:
            return NO_CORNERS
        half = int(min(MAX_HALF_WINDOW_PX, spacing_px / 2 - 1))
        # Better than the finder's own fraction of a pixel, which is that of a fitted grid.
        refined = cv2.cornerSubPix(gray, pixels, (half, half), (-1, -1), SUBPIXEL_CRITERIA)
        return BoardCorners(refined.reshape(-1, 2).astype(np.float64), self.layout.inner_corners_m)

    def suggest_other_board(self, gray: GrayImage) -> str:
        """A chessboard of any other size."""
        flags = FIND_FLAGS | cv2.CALIB_CB_LARGER
        found, _, meta = cv2.findChessboardCornersSBWithMeta(gray, MIN_PATTERN, flags)
        if not found or meta.shape[:2] in (self._inner_corners, self._inner_corners[::-1]):
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
    def _inner_corners(self) -> tuple[int, int]:
        return self.layout.columns - 1, self.layout.rows - 1


def _min_spacing_px(grid: Array) -> float:
    """The least distance between neighbours along the second axis of (rows, columns, 2)."""
    return float(np.linalg.norm(np.diff(grid, axis=1), axis=2).min())
