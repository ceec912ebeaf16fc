"""Plain chessboard, which must be completely visible."""

from dataclasses import dataclass

import cv2
import numpy as np

from drivers.core.geometry import Array
from vo_service.tools.calibration.board import NO_CORNERS, BoardCorners, BoardLayout, GrayImage

# Refinement windows have up to 11 x 11 pixels, less if corners are close together.
MAX_HALF_WINDOW_PX = 5
MIN_SPACING_PX = 6.0
SUBPIXEL_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
FIND_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE
# The detector extends a board of this size as far as possible.
MIN_PATTERN = (3, 3)


@dataclass(frozen=True)
class Chessboard:
    """Chessboard of black and white squares."""

    layout: BoardLayout

    @property
    def name(self) -> str:
        """Name with the number of inner corners, as in the option."""
        columns, rows = self._inner_corners
        return f"chessboard of {columns}x{rows} inner corners"

    def find_corners(self, gray: GrayImage) -> BoardCorners:
        """Find all inner corners or none."""
        is_found, pixels = cv2.findChessboardCornersSB(gray, self._inner_corners, flags=FIND_FLAGS)
        if not is_found:
            return NO_CORNERS
        columns, rows = self._inner_corners
        grid = pixels.reshape(rows, columns, 2).astype(np.float64)
        spacing_px = min(_min_spacing_px(grid), _min_spacing_px(grid.transpose(1, 0, 2)))
        if spacing_px < MIN_SPACING_PX:
            return NO_CORNERS
        half_window = int(min(MAX_HALF_WINDOW_PX, spacing_px / 2 - 1))
        # More accurate than the detector's subpixel positions, which come from a fitted grid.
        refined = cv2.cornerSubPix(
            gray, pixels, (half_window, half_window), (-1, -1), SUBPIXEL_CRITERIA
        )
        return BoardCorners(refined.reshape(-1, 2).astype(np.float64), self.layout.inner_corners_m)

    def suggest_other_board(self, gray: GrayImage) -> str:
        """Return the option for a chessboard of another size in the image, or ""."""
        flags = FIND_FLAGS | cv2.CALIB_CB_LARGER
        is_found, _, meta = cv2.findChessboardCornersSBWithMeta(gray, MIN_PATTERN, flags)
        if not is_found or meta.shape[:2] in (self._inner_corners, self._inner_corners[::-1]):
            return ""
        rows, columns = sorted(meta.shape[:2])
        return f"chessboard:{columns}x{rows}"

    def dark_cells_m(self) -> Array:
        """Return every other square, starting with the first."""
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
    """Return the minimum distance of neighbors along the second axis of (rows, columns, 2)."""
    return float(np.linalg.norm(np.diff(grid, axis=1), axis=2).min())
