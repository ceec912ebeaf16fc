"""Options for the board and their errors."""

import pytest

from drivers.core.errors import InputError
from vo_service.tools.calibration.board_options import BoardOptions, make_board
from vo_service.tools.calibration.charuco import Charuco


def test_a_chessboard_is_given_by_its_inner_corners() -> None:
    board = make_board(BoardOptions("chessboard:9x6", 0.025, None, "4X4_100"))
    assert (board.layout.columns, board.layout.rows) == (10, 7)
    assert board.name == "chessboard of 9x6 inner corners"


def test_a_charuco_board_is_given_by_its_squares() -> None:
    board = make_board(BoardOptions("charuco:8x6", 0.04, None, "4X4_100"))
    assert isinstance(board, Charuco)
    assert (board.layout.columns, board.layout.rows, board.marker_m) == (8, 6, 0.7 * 0.04)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            BoardOptions("chess:9x6", 0.025, None, "4X4_100"),
            "chess:9x6: is not a board; write chessb",
        ),
        (BoardOptions("chessboard:9", 0.025, None, "4X4_100"), "chessboard:9: is not a board"),
        (BoardOptions("chessboard:9x2", 0.025, None, "4X4_100"), "use 3 to 100 columns and rows"),
        (BoardOptions("chessboard:9x6", None, None, "4X4_100"), "--square is missing: measure a"),
        (BoardOptions("charuco:8x6", 0.04, 0.04, "4X4_100"), "must be smaller than the square"),
        (BoardOptions("charuco:8x6", 0.04, None, "9X9"), "--dictionary 9X9: is unknown; use one"),
    ],
)
def test_a_wrong_option_is_named(options: BoardOptions, message: str) -> None:
    with pytest.raises(InputError) as caught:
        make_board(options)
    assert message in str(caught.value)
