"""Calibration boards: their layout and their corners.

Board coordinates: the origin is the outer corner of the first square, x points along the columns,
y down the rows, z into the board.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array

GrayImage = NDArray[np.uint8]


@dataclass(frozen=True)
class BoardCorners:
    """Corners of squares that were found in one image.

    Attributes:
        pixels: (N, 2) columns and rows; the center of the first pixel is (0, 0).
        points_m: (N, 3) the same corners in board coordinates.
    """

    pixels: Array
    points_m: Array


NO_CORNERS = BoardCorners(np.empty((0, 2)), np.empty((0, 3)))


@dataclass(frozen=True)
class BoardLayout:
    """Layout of a board: `columns` by `rows` squares with the side `square_m`."""

    columns: int
    rows: int
    square_m: float

    @property
    def width_m(self) -> float:
        """Width of all columns, m."""
        return self.columns * self.square_m

    @property
    def height_m(self) -> float:
        """Height of all rows, m."""
        return self.rows * self.square_m

    @property
    def inner_corners_m(self) -> Array:
        """Inner corners ((columns - 1) * (rows - 1), 3) in board coordinates, row by row."""
        x, y = np.meshgrid(np.arange(1.0, self.columns), np.arange(1.0, self.rows))
        z = np.zeros_like(x)
        return self.square_m * np.column_stack([x.ravel(), y.ravel(), z.ravel()])

    @property
    def inner_rectangle_m(self) -> Array:
        """Corners (4, 3) of a rectangle half a square within the pattern."""
        low, right = 0.5 * self.square_m, self.width_m - 0.5 * self.square_m
        bottom = self.height_m - 0.5 * self.square_m
        return np.array([[low, low, 0], [right, low, 0], [right, bottom, 0], [low, bottom, 0]])


class Board(Protocol):
    """Kind of calibration board."""

    @property
    def layout(self) -> BoardLayout:
        """Layout of the squares."""
        ...

    @property
    def name(self) -> str:
        """Name for people: "chessboard of 9x6 inner corners"."""
        ...

    def find_corners(self, gray: GrayImage) -> BoardCorners:
        """Find the corners with subpixel accuracy; NO_CORNERS if the board is not visible."""
        ...

    def suggest_other_board(self, gray: GrayImage) -> str:
        """Return the --board option of a similar board in the image, or ""."""
        ...

    def dark_cells_m(self) -> Array:
        """Return rectangles (N, 4) to print in black: x, y, width, height in board coordinates."""
        ...
