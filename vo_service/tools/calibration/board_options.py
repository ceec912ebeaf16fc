"""What the command line says about the board."""

import re
from dataclasses import dataclass

from drivers.core.errors import InputError
from vo_service.tools.calibration.board import Board, BoardLayout
from vo_service.tools.calibration.charuco import DICTIONARIES, Charuco
from vo_service.tools.calibration.chessboard import Chessboard

USAGE = "chessboard:9x6 (inner corners) or charuco:8x6 (squares)"
_BOARD_PATTERN = re.compile(r"(chessboard|charuco):(\d{1,3})x(\d{1,3})")
MIN_SQUARES, MAX_SQUARES = 3, 100
# The marker's part of a square where nothing is said, as printed by --print-board.
DEFAULT_MARKER_RATIO = 0.7


@dataclass(frozen=True)
class BoardOptions:
    """--board, --square, --marker and --dictionary as they were given."""

    board: str
    square_m: float | None
    marker_m: float | None
    dictionary: str


def make_board(options: BoardOptions) -> Board:
    """The board that was described. Raises InputError naming the option that is wrong."""
    form = _BOARD_PATTERN.fullmatch(options.board)
    if form is None:
        raise InputError(f"--board {options.board}: is no board; write {USAGE}")
    if options.square_m is None:
        raise InputError(
            "--square is missing: measure a square of the printed board and give its side in "
            "metres, such as --square 0.025"
        )
    kind, columns, rows = form[1], int(form[2]), int(form[3])
    if not (MIN_SQUARES <= columns <= MAX_SQUARES and MIN_SQUARES <= rows <= MAX_SQUARES):
        raise InputError(f"--board {options.board}: give {MIN_SQUARES} to {MAX_SQUARES} each way")
    if kind == "chessboard":
        return Chessboard(BoardLayout(columns + 1, rows + 1, options.square_m))
    return _make_charuco(BoardLayout(columns, rows, options.square_m), options)


def _make_charuco(layout: BoardLayout, options: BoardOptions) -> Charuco:
    marker_m = options.marker_m or DEFAULT_MARKER_RATIO * layout.square_m
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
