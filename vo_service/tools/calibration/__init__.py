"""Calibration boards, their printed page, and raw images and views of them.

Board coordinates: the origin is the outer corner of the first square, x points along the columns,
y down the rows, z into the board.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import Distortion
from drivers.core.files import atomic_write, check_suffix
from drivers.core.geometry import Array, rigid_transform, so3_exp
from drivers.core.write_errors import check_output_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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


FORMATS = (".pdf", ".svg", ".png")
PAPERS_MM = {"A4": (297.0, 210.0), "A3": (420.0, 297.0), "A2": (594.0, 420.0), "A1": (841.0, 594.0)}
MM_PER_INCH = 25.4
DOTS_PER_INCH = 300
# White margin around the pattern: board detection needs it, and printers leave an edge blank.
SIDE_MM, TOP_MM, BOTTOM_MM = 8.0, 8.0, 21.0
RULER_MM = 100.0
TEXT_POINTS = 7.0


def choose_paper(board: Board) -> tuple[str, tuple[float, float]]:
    """Return name and (width, height), mm, of the smallest paper for the board."""
    page_width_mm = 1e3 * board.layout.width_m + 2 * SIDE_MM
    page_height_mm = 1e3 * board.layout.height_m + TOP_MM + BOTTOM_MM
    for name, (width_mm, height_mm) in PAPERS_MM.items():
        if page_width_mm <= width_mm and page_height_mm <= height_mm:
            return name, (width_mm, height_mm)
        if page_width_mm <= height_mm and page_height_mm <= width_mm:
            return name, (height_mm, width_mm)
    page_width_mm = max(page_width_mm, RULER_MM + 2 * SIDE_MM)
    return f"{page_width_mm:.0f} x {page_height_mm:.0f} mm", (page_width_mm, page_height_mm)


def print_board(board: Board, path: Path) -> str:
    """Write a page to print at 100 % and return the name of its paper.

    Raises:
        InputError: The suffix is not a known format, or the file cannot be written.
    """
    suffix = check_suffix(path, FORMATS)
    check_output_file(path)
    name, size_mm = choose_paper(board)
    image = io.BytesIO()
    _draw(board, size_mm).savefig(image, format=suffix.removeprefix("."), dpi=DOTS_PER_INCH)
    atomic_write(path, image.getvalue())
    return name


def _draw(board: Board, size_mm: tuple[float, float]) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    width_mm, height_mm = size_mm
    figure = Figure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH))
    FigureCanvasAgg(figure)
    # One axes object over the whole page, in millimeters from its top left corner.
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, width_mm), ylim=(height_mm, 0))
    page.axis("off")
    left_mm = (width_mm - 1e3 * board.layout.width_m) / 2
    # Centered in the space above the ruler.
    top_mm = TOP_MM + (height_mm - TOP_MM - BOTTOM_MM - 1e3 * board.layout.height_m) / 2
    # One path, because viewers would show seams between separate cells.
    origin_mm = np.array([left_mm, top_mm])
    cells = [_rectangle(cell) + origin_mm for cell in 1e3 * board.dark_cells_m()]
    codes = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY]
    outline = Outline(np.concatenate(cells), codes * len(cells))
    page.add_patch(PathPatch(outline, facecolor="black", linewidth=0, snap=False))
    _draw_ruler(page, width_mm, height_mm - 13.0)
    _write_caption(page, board, width_mm, height_mm - 8.0)
    return figure


def _rectangle(cell: Array) -> Array:
    """Return corners (5, 2) of a closed outline."""
    x, y, width, height = cell
    return np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height], [x, y]])


def _draw_ruler(page: "Axes", width_mm: float, y_mm: float) -> None:
    left_mm = (width_mm - RULER_MM) / 2
    for start, end in _ruler_lines(left_mm, y_mm):
        page.plot([start[0], end[0]], [start[1], end[1]], color="black", linewidth=0.5)
    page.text(left_mm - 1.5, y_mm, "0", ha="right", va="center", fontsize=TEXT_POINTS)
    page.text(left_mm + RULER_MM + 1.5, y_mm, "100 mm", va="center", fontsize=TEXT_POINTS)


def _ruler_lines(left_mm: float, y_mm: float) -> Iterator[tuple[Array, Array]]:
    yield np.array([left_mm, y_mm]), np.array([left_mm + RULER_MM, y_mm])
    for tick in range(11):
        x_mm, half_length_mm = left_mm + RULER_MM * tick / 10, 2.0 if tick % 5 == 0 else 1.0
        yield np.array([x_mm, y_mm - half_length_mm]), np.array([x_mm, y_mm + half_length_mm])


def _write_caption(page: "Axes", board: Board, width_mm: float, y_mm: float) -> None:
    name = f"{board.name[0].upper()}{board.name[1:]}"
    text = (
        f"{name}, squares of {1e3 * board.layout.square_m:g} mm. Print at 100 %, without "
        "fitting to the page; measure the line, and a square for --square."
    )
    page.text(width_mm / 2, y_mm, text, ha="center", va="center", fontsize=TEXT_POINTS)
