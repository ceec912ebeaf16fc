"""ChArUco board: a chessboard with markers, which may be partly visible."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from cv2 import aruco
from numpy.typing import NDArray

from drivers.core.errors import InputError
from drivers.core.geometry import Array
from vo_service.tools.calibration.board import NO_CORNERS, BoardCorners, BoardLayout, GrayImage
from vo_service.tools.calibration.chessboard import SUBPIXEL_CRITERIA

# Fewer corners give little information, and may all lie in two rows.
MIN_CORNERS = 12
# The refinement window must not include markers, which start an eighth of a square away.
HALF_WINDOW_RATIO = 0.12
MIN_HALF_WINDOW_PX = 2
MIN_SQUARE_PX = 14.0
DICTIONARIES = sorted(
    name.removeprefix("DICT_") for name in vars(aruco) if name.startswith("DICT_")
)


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
        for detector in self._detectors:
            pixels, ids, _, _ = detector.detectBoard(gray)
            if ids is not None and len(ids) >= MIN_CORNERS:
                points_m = self.layout.inner_corners_m[np.ravel(ids)]
                return self._refine_corners(gray, np.asarray(pixels, np.float32), points_m)
        return NO_CORNERS

    def _refine_corners(
        self, gray: GrayImage, pixels: NDArray[np.float32], points_m: Array
    ) -> BoardCorners:
        """Refine to a tenth of a pixel; NO_CORNERS if the corners are too close together."""
        square_px = _square_px(pixels.reshape(-1, 2), points_m, self.layout.square_m)
        if square_px < MIN_SQUARE_PX:
            return NO_CORNERS
        half_window = max(MIN_HALF_WINDOW_PX, round(HALF_WINDOW_RATIO * square_px))
        refined = cv2.cornerSubPix(
            gray, pixels, (half_window, half_window), (-1, -1), SUBPIXEL_CRITERIA
        )
        return BoardCorners(refined.reshape(-1, 2).astype(np.float64), points_m)

    def suggest_other_board(self, gray: GrayImage) -> str:
        """Return the option for markers of another dictionary in the image, or ""."""
        for name in DICTIONARIES:
            detector = aruco.ArucoDetector(_dictionary(name))
            _, ids, _ = detector.detectMarkers(gray)
            if name != self.dictionary and ids is not None and len(ids) >= MIN_CORNERS:
                return f"{self._option} --dictionary {name}"
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

    @property
    def _option(self) -> str:
        return f"charuco:{self.layout.columns}x{self.layout.rows}"

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

    @cached_property
    def _detectors(self) -> list[aruco.CharucoDetector]:
        return [aruco.CharucoDetector(board) for board in self._boards]


def _square_px(pixels: NDArray[np.float32], points_m: Array, square_m: float) -> float:
    """Return the shortest projected side of a square, without distortion."""
    H = np.asarray(cv2.findHomography(points_m[:, :2], pixels)[0], np.float64)
    if H.shape != (3, 3):  # no homography for collinear corners
        return 0.0
    sides = [np.array([square_m, 0.0]), np.array([0.0, square_m])]
    origins = _project(H, points_m[:, :2])
    ends = [_project(H, points_m[:, :2] + side) for side in sides]
    return float(min(np.linalg.norm(end - origins, axis=1).min() for end in ends))


def _project(H: Array, points: Array) -> Array:
    scaled = np.column_stack([points, np.ones(len(points))]) @ H.T
    pixels: Array = scaled[:, :2] / scaled[:, 2:]
    return pixels


def _dictionary(name: str) -> aruco.Dictionary:
    return aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{name}"))
