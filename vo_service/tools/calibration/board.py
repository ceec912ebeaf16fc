"""Calibration boards, and raw images and views of them.

Board coordinates: the origin is the outer corner of the first square, x points along the columns,
y down the rows, z into the board.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import Distortion
from drivers.core.geometry import Array, rigid_transform, so3_exp

GrayImage = NDArray[np.uint8]
NO_DEPTH: NDArray[np.uint16] = np.zeros((0, 0), np.uint16)


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


def make_view(snapshot: Snapshot, corners: BoardCorners) -> BoardView:
    """Make a view from a snapshot and its corners."""
    return BoardView(snapshot.name, snapshot.size, corners, snapshot.depth_raw)


@dataclass(frozen=True)
class Lens:
    """Intrinsics and distortion (k1 k2 p1 p2 k3, OpenCV's order)."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion

    @property
    def K(self) -> Array:
        """3x3 intrinsics matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def vector(self) -> Array:
        """(9,) fx fy cx cy k1 k2 p1 p2 k3."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])

    def project(self, T_camera_board: Array, points_m: Array) -> Array:
        """Return the pixels (N, 2) of points (N, 3) in board coordinates."""
        rotation = cv2.Rodrigues(T_camera_board[:3, :3])[0]
        pixels, _ = cv2.projectPoints(
            points_m, rotation, T_camera_board[:3, 3], self.K, np.array(self.distortion)
        )
        return np.asarray(pixels, np.float64).reshape(-1, 2)


def solve_board_pose(lens: Lens, corners: BoardCorners) -> Array:
    """Return the 4x4 T_camera_board of a planar board."""
    _, rotation, translation = cv2.solvePnP(
        corners.points_m,
        corners.pixels,
        lens.K,
        np.array(lens.distortion),
        flags=cv2.SOLVEPNP_IPPE,
    )
    return rigid_transform(so3_exp(rotation.ravel()), translation.ravel())
