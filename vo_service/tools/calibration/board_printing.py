"""The page of a board, to print at 100 %."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.geometry import Array
from vo_service.figures import new_figure, write_figure
from vo_service.tools.calibration.board import Board

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    name, size_mm = choose_paper(board)
    write_figure(path, FORMATS, lambda: _draw(board, size_mm), dpi=DOTS_PER_INCH)
    return name


def _draw(board: Board, size_mm: tuple[float, float]) -> "Figure":
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    width_mm, height_mm = size_mm
    figure = new_figure(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH, layout=None)
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
    page.plot([left_mm, left_mm + RULER_MM], [y_mm, y_mm], color="black", linewidth=0.5)
    for tick in range(11):
        x_mm, half_length_mm = left_mm + RULER_MM * tick / 10, 2.0 if tick % 5 == 0 else 1.0
        ends_mm = [y_mm - half_length_mm, y_mm + half_length_mm]
        page.plot([x_mm, x_mm], ends_mm, color="black", linewidth=0.5)
    page.text(left_mm - 1.5, y_mm, "0", ha="right", va="center", fontsize=TEXT_POINTS)
    page.text(left_mm + RULER_MM + 1.5, y_mm, "100 mm", va="center", fontsize=TEXT_POINTS)


def _write_caption(page: "Axes", board: Board, width_mm: float, y_mm: float) -> None:
    name = f"{board.name[0].upper()}{board.name[1:]}"
    text = (
        f"{name}, squares of {1e3 * board.layout.square_m:g} mm. Print at 100 %, without "
        "fitting to the page; measure the line, and a square for --square."
    )
    page.text(width_mm / 2, y_mm, text, ha="center", va="center", fontsize=TEXT_POINTS)
