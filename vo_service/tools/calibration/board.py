"""Boards: where their corners are in an image, and on the board itself.

Board coordinates: the origin is the outer corner of the first square, x runs along the columns, y
down the rows, z into the board.
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

    pixels    (N, 2) columns and rows; the centre of the first pixel is (0, 0)
    points_m  (N, 3) the same corners in board coordinates
    """

    pixels: Array
    points_m: Array


NO_CORNERS = BoardCorners(np.empty((0, 2)), np.empty((0, 3)))


@dataclass(frozen=True)
class BoardLayout:
    """Squares of a board: `columns` by `rows`, each of side `square_m`."""

    columns: int
    rows: int
    square_m: float

    @property
    def width_m(self) -> float:
        """From the first column's edge to the last's."""
        return self.columns * self.square_m

    @property
    def height_m(self) -> float:
        """From the first row's edge to the last's."""
        return self.rows * self.square_m

    @property
    def inner_corners_m(self) -> Array:
        """((columns - 1) * (rows - 1), 3) in board coordinates, row by row."""
        x, y = np.meshgrid(np.arange(1.0, self.columns), np.arange(1.0, self.rows))
        flat = np.zeros_like(x)
        return self.square_m * np.column_stack([x.ravel(), y.ravel(), flat.ravel()])

    @property
    def inner_rectangle_m(self) -> Array:
        """(4, 3) a rectangle half a square within the pattern: surely on the board."""
        low, right = 0.5 * self.square_m, self.width_m - 0.5 * self.square_m
        bottom = self.height_m - 0.5 * self.square_m
        return np.array([[low, low, 0], [right, low, 0], [right, bottom, 0], [low, bottom, 0]])


class Board(Protocol):
    """What a calibration can look for."""

    @property
    def layout(self) -> BoardLayout:
        """Its squares."""
        ...

    @property
    def name(self) -> str:
        """For people: "chessboard of 9x6 inner corners"."""
        ...

    def find_corners(self, gray: GrayImage) -> BoardCorners:
        """Its corners to a fraction of a pixel; NO_CORNERS where it is not seen well enough."""
        ...

    def suggest_other_board(self, gray: GrayImage) -> str:
        """The option for a similar board that the image shows; "" if there is none."""
        ...

    def dark_cells_m(self) -> Array:
        """(N, 4) rectangles to print in black: x, y, width, height in board coordinates."""
        ...
