"""Options of the command line for the board."""

import re
from dataclasses import dataclass

from drivers.core.errors import InputError
from vo_service.tools.calibration.board import Board, BoardLayout
from vo_service.tools.calibration.charuco import DICTIONARIES, Charuco
from vo_service.tools.calibration.chessboard import Chessboard

USAGE = "chessboard:9x6 (inner corners) or charuco:8x6 (squares)"
_BOARD_PATTERN = re.compile(r"(chessboard|charuco):(\d{1,3})x(\d{1,3})")
MIN_SQUARES, MAX_SQUARES = 3, 100
# Default side of a marker relative to its square, also for --print-board.
DEFAULT_MARKER_RATIO = 0.7


@dataclass(frozen=True)
class BoardOptions:
    """Values of --board, --square, --marker and --dictionary."""

    board: str
    square_m: float | None
    marker_m: float | None
    dictionary: str


def make_board(options: BoardOptions) -> Board:
    """Make the board of the options. Raises InputError with the name of a wrong option."""
    match = _BOARD_PATTERN.fullmatch(options.board)
    if match is None:
        raise InputError(f"--board {options.board}: is not a board; write {USAGE}")
    if options.square_m is None:
        raise InputError(
            "--square is missing: measure a square of the printed board and give its side in "
            "meters, such as --square 0.025"
        )
    kind, columns, rows = match[1], int(match[2]), int(match[3])
    if not (MIN_SQUARES <= columns <= MAX_SQUARES and MIN_SQUARES <= rows <= MAX_SQUARES):
        raise InputError(
            f"--board {options.board}: use {MIN_SQUARES} to {MAX_SQUARES} columns and rows"
        )
    if kind == "chessboard":
        return Chessboard(BoardLayout(columns + 1, rows + 1, options.square_m))
    return _make_charuco(BoardLayout(columns, rows, options.square_m), options)


def _make_charuco(layout: BoardLayout, options: BoardOptions) -> Charuco:
    marker_m = options.marker_m or DEFAULT_MARKER_RATIO * layout.square_m
    if marker_m >= layout.square_m:
        raise InputError(
            f"--marker {marker_m:g}: must be smaller than the square ({layout.square_m:g} m)"
        )
    if options.dictionary not in DICTIONARIES:
        known = ", ".join(name for name in DICTIONARIES if name.endswith("_100"))
        raise InputError(
            f"--dictionary {options.dictionary}: is unknown; use one of OpenCV's, such as {known}"
        )
    return Charuco(layout, marker_m, options.dictionary)
