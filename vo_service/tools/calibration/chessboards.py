"""Chessboards, plain and with ChArUco markers, and their choice by the options."""

import re
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from cv2 import aruco
from cv2.typing import MatLike
from numpy.typing import NDArray

from drivers.core import InputError
from drivers.core.geometry import Array
from vo_service.tools.calibration.board import (
    NO_CORNERS,
    Board,
    BoardCorners,
    BoardLayout,
    GrayImage,
)

# Refinement windows have up to 11 x 11 pixels, less if corners are close together.
MAX_HALF_WINDOW_PX = 5
MIN_SPACING_PX = 6.0
SUBPIXEL_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
FIND_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE
# The detector extends a board of this size as far as possible.
MIN_PATTERN = (3, 3)
# Fewer corners give little information, and may all lie in two rows.
MIN_CORNERS = 12
# Largest change from one step between corners to the next, relative to the step. Measured: at most
# 0.25 on steeply tilted boards in a distorted image, at least 0.5 on grids found in noise.
MAX_STEP_CHANGE = 0.4
# The refinement window must not include markers, which start an eighth of a square away.
HALF_WINDOW_RATIO = 0.12
MIN_HALF_WINDOW_PX = 2
MIN_SQUARE_PX = 14.0
DICTIONARIES = sorted(
    name.removeprefix("DICT_") for name in vars(aruco) if name.startswith("DICT_")
)
USAGE = "chessboard:9x6 (inner corners) or charuco:8x6 (squares)"
_BOARD_PATTERN = re.compile(r"(chessboard|charuco):(\d{1,3})x(\d{1,3})")
MIN_SQUARES, MAX_SQUARES = 3, 100
# Default side of a marker relative to its square, also for --print-board.
DEFAULT_MARKER_RATIO = 0.7


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
        if spacing_px < MIN_SPACING_PX or not _is_regular(grid):
            return NO_CORNERS
        half_window = int(min(MAX_HALF_WINDOW_PX, spacing_px / 2 - 1))
        # More accurate than the detector's subpixel positions, which come from a fitted grid.
        return _refine_corners(gray, pixels, half_window, self.layout.inner_corners_m)

    def suggest_other_board(self, gray: GrayImage) -> str:
        """Return the option for a chessboard of another size in the image, or ""."""
        flags = FIND_FLAGS | cv2.CALIB_CB_LARGER
        is_found, pixels, meta = cv2.findChessboardCornersSBWithMeta(gray, MIN_PATTERN, flags)
        if not is_found or meta.shape[:2] in (self._inner_corners, self._inner_corners[::-1]):
            return ""
        if len(pixels) < MIN_CORNERS or not _is_regular(
            np.asarray(pixels, np.float64).reshape(*meta.shape[:2], 2)
        ):
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


def _refine_corners(
    gray: GrayImage, pixels: MatLike, half_window: int, points_m: Array
) -> BoardCorners:
    """Refine the pixels of corners to a tenth of a pixel."""
    window = (half_window, half_window)
    refined = cv2.cornerSubPix(gray, pixels, window, (-1, -1), SUBPIXEL_CRITERIA)
    return BoardCorners(refined.reshape(-1, 2).astype(np.float64), points_m)


def _min_spacing_px(grid: Array) -> float:
    """Return the minimum distance of neighbors along the second axis of (rows, columns, 2)."""
    return float(np.linalg.norm(np.diff(grid, axis=1), axis=2).min())


def _is_regular(grid: Array) -> bool:
    """Whether the steps between the corners (rows, columns, 2) change smoothly, as on a board."""
    for corners in (grid, grid.transpose(1, 0, 2)):
        steps = np.diff(corners, axis=1)
        lengths = np.linalg.norm(steps, axis=2)
        changes = np.linalg.norm(np.diff(steps, axis=1), axis=2)
        if (changes > MAX_STEP_CHANGE * np.minimum(lengths[:, 1:], lengths[:, :-1])).any():
            return False
    return True


@dataclass(frozen=True)
class Charuco:
    """Chessboard whose white squares have markers with the side `marker_m` from a dictionary.

    Raises:
        InputError: The dictionary has too few markers.
    """

    layout: BoardLayout
    marker_m: float
    dictionary: str

    def __post_init__(self) -> None:
        needed = self.layout.columns * self.layout.rows // 2
        available = len(self._dictionary.bytesList)
        if needed > available:
            raise InputError(
                f"--dictionary {self.dictionary} has {available} markers, the board needs "
                f"{needed}; name a larger one"
            )

    @property
    def name(self) -> str:
        """Name with the number of squares, as in the option."""
        size = f"{self.layout.columns}x{self.layout.rows}"
        return f"ChArUco board of {size} squares, dictionary {self.dictionary}"

    def find_corners(self, gray: GrayImage) -> BoardCorners:
        """Find the inner corners beside detected markers."""
        for board in self._boards:
            pixels, ids, _, _ = aruco.CharucoDetector(board).detectBoard(gray)
            if ids is not None and len(ids) >= MIN_CORNERS:
                points_m = self.layout.inner_corners_m[np.ravel(ids)]
                found = np.asarray(pixels, np.float32)
                square_px = _square_px(found.reshape(-1, 2), points_m, self.layout.square_m)
                if square_px < MIN_SQUARE_PX:  # too close together
                    return NO_CORNERS
                half_window = max(MIN_HALF_WINDOW_PX, round(HALF_WINDOW_RATIO * square_px))
                return _refine_corners(gray, found, half_window, points_m)
        return NO_CORNERS

    def suggest_other_board(self, gray: GrayImage) -> str:
        """Return the option for markers of another dictionary in the image, or ""."""
        for name in DICTIONARIES:
            detector = aruco.ArucoDetector(_dictionary(name))
            _, ids, _ = detector.detectMarkers(gray)
            if name != self.dictionary and ids is not None and len(ids) >= MIN_CORNERS:
                return f"charuco:{self.layout.columns}x{self.layout.rows} --dictionary {name}"
        return ""

    def dark_cells_m(self) -> Array:
        """Return the squares without a marker, and the dark bits of the markers."""
        side = self.layout.square_m
        corners = [np.asarray(points)[0, :2] for points in self._boards[0].getObjPoints()]
        marker_squares = {(int(x // side), int(y // side)) for x, y in corners}
        squares = np.ndindex(self.layout.columns, self.layout.rows)
        cells = [
            (c * side, r * side, side, side) for c, r in squares if (c, r) not in marker_squares
        ]
        for corner, number in zip(corners, np.ravel(self._boards[0].getIds()), strict=True):
            cells.extend(self._dark_bits_m(corner, int(number)))
        return np.array(cells)

    def _dark_bits_m(self, corner_m: Array, number: int) -> list[tuple[float, float, float, float]]:
        """Return the dark rectangles of one marker, with its border."""
        bits = self._dictionary.markerSize + 2
        side = self.marker_m / bits
        dark = np.argwhere(self._dictionary.generateImageMarker(number, bits) == 0)
        x_m, y_m = (float(value) for value in corner_m)
        return [(x_m + column * side, y_m + row * side, side, side) for row, column in dark]

    @cached_property
    def _dictionary(self) -> aruco.Dictionary:
        return _dictionary(self.dictionary)

    @cached_property
    def _boards(self) -> list[aruco.CharucoBoard]:
        """The board, and for an even number of rows also its layout in older versions of OpenCV."""
        size = (self.layout.columns, self.layout.rows)
        square_m = self.layout.square_m
        boards = []
        for is_legacy in (False, True)[: 2 - self.layout.rows % 2]:
            board = aruco.CharucoBoard(size, square_m, self.marker_m, self._dictionary)
            board.setLegacyPattern(is_legacy)
            boards.append(board)
        return boards


def _square_px(pixels: NDArray[np.float32], points_m: Array, square_m: float) -> float:
    """Return the shortest projected side of a square, without distortion."""
    H = np.asarray(cv2.findHomography(points_m[:, :2], pixels)[0], np.float64)
    if H.shape != (3, 3):  # no homography for collinear corners
        return 0.0
    origins, *ends = (
        cv2.perspectiveTransform(points_m[None, :, :2] + side, H)[0]
        for side in ([0.0, 0.0], [square_m, 0.0], [0.0, square_m])
    )
    return float(min(np.linalg.norm(end - origins, axis=1).min() for end in ends))


def _dictionary(name: str) -> aruco.Dictionary:
    return aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{name}"))


def make_board(name: str, square_m: float | None, marker_m: float | None, dictionary: str) -> Board:
    """Make the board of --board, --square, --marker and --dictionary.

    Raises:
        InputError: One of them is not valid; the text names it.
    """
    match = _BOARD_PATTERN.fullmatch(name)
    if match is None:
        raise InputError(f"--board {name}: is not a board; write {USAGE}")
    if square_m is None:
        raise InputError(
            "--square is missing: measure a square of the printed board and give its side in "
            "meters, such as --square 0.025"
        )
    kind, columns, rows = match[1], int(match[2]), int(match[3])
    if not (MIN_SQUARES <= columns <= MAX_SQUARES and MIN_SQUARES <= rows <= MAX_SQUARES):
        raise InputError(f"--board {name}: use {MIN_SQUARES} to {MAX_SQUARES} columns and rows")
    if kind == "chessboard":
        return Chessboard(BoardLayout(columns + 1, rows + 1, square_m))
    marker_m = marker_m or DEFAULT_MARKER_RATIO * square_m
    if marker_m >= square_m:
        raise InputError(f"--marker {marker_m:g}: must be smaller than the square ({square_m:g} m)")
    if dictionary not in DICTIONARIES:
        known = ", ".join(name for name in DICTIONARIES if name.endswith("_100"))
        raise InputError(
            f"--dictionary {dictionary}: is unknown; use one of OpenCV's, such as {known}"
        )
    return Charuco(BoardLayout(columns, rows, square_m), marker_m, dictionary)
