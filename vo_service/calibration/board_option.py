"""What the command line says about the board."""

import re
from dataclasses import dataclass

from drivers.errors import InputError
from vo_service.calibration.board import Board, Layout
from vo_service.calibration.charuco import DICTIONARIES, Charuco
from vo_service.calibration.chessboard import Chessboard

USAGE = "chessboard:9x6 (inner corners) or charuco:8x6 (squares)"
_FORM = re.compile(r"(chessboard|charuco):(\d{1,3})x(\d{1,3})")
FEWEST, MOST = 3, 100
# The marker's part of a square where nothing is said, as printed by --print-board.
MARKER_PART = 0.7


@dataclass(frozen=True)
class BoardOptions:
    """--board, --square, --marker and --dictionary as they were given."""

    board: str
    square_m: float | None
    marker_m: float | None
    dictionary: str


def board_of(options: BoardOptions) -> Board:
    """The board that was described. Raises InputError naming the option that is wrong."""
    form = _FORM.fullmatch(options.board)
    if form is None:
        raise InputError(f"--board {options.board}: is no board; write {USAGE}")
    if options.square_m is None:
        raise InputError(
            "--square is missing: measure a square of the printed board and give its side in "
            "metres, such as --square 0.025"
        )
    kind, columns, rows = form[1], int(form[2]), int(form[3])
    if not (FEWEST <= columns <= MOST and FEWEST <= rows <= MOST):
        raise InputError(f"--board {options.board}: give {FEWEST} to {MOST} each way")
    if kind == "chessboard":
        return Chessboard(Layout(columns + 1, rows + 1, options.square_m))
    return _charuco(Layout(columns, rows, options.square_m), options)


def _charuco(layout: Layout, options: BoardOptions) -> Charuco:
    marker_m = options.marker_m or MARKER_PART * layout.square_m
    if marker_m >= layout.square_m:
        raise InputError(
            f"--marker {marker_m:g}: a marker is smaller than its square ({layout.square_m:g} m)"
        )
    if options.dictionary not in DICTIONARIES:
        known = ", ".join(name for name in DICTIONARIES if name.endswith("_100"))
        raise InputError(
            f"--dictionary {options.dictionary}: is unknown; use one of OpenCV's, such as {known}"
        )
    return Charuco(layout, marker_m, options.dictionary)
