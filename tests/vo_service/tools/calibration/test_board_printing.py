"""The printed board has the correct size."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from vo_service.tools.calibration.board import Board, BoardLayout
from vo_service.tools.calibration.board_printing import DOTS_PER_INCH, choose_paper, print_board
from vo_service.tools.calibration.chessboards import Charuco, Chessboard

CHESSBOARD = Chessboard(BoardLayout(10, 7, 0.025))
CHARUCO = Charuco(BoardLayout(8, 6, 0.030), 0.021, "4X4_100")
# The scan has a third of the resolution.
SCAN = 3
AREA = cv2.INTER_AREA
DOTS_PER_MM = DOTS_PER_INCH / 25.4


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO])
def test_the_squares_on_paper_have_the_requested_size(board: Board, tmp_path: Path) -> None:
    assert print_board(board, tmp_path / "board.png") == "A4"
    page = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    assert page is not None
    assert page.shape == (2480, 3507)
    scan = np.asarray(
        cv2.resize(page, None, fx=1 / SCAN, fy=1 / SCAN, interpolation=AREA), np.uint8
    )
    corners = board.find_corners(scan)
    assert len(corners.pixels) == len(board.layout.inner_corners_m)
    on_paper_mm = (corners.pixels - corners.pixels[0]) * SCAN / DOTS_PER_MM
    on_board_mm = 1e3 * (corners.points_m - corners.points_m[0])[:, :2]
    errors_mm = np.abs(on_paper_mm) - np.abs(on_board_mm)
    assert np.abs(errors_mm).max() < 0.1


def test_the_ruler_is_a_hundred_millimeters_long(tmp_path: Path) -> None:
    print_board(CHESSBOARD, tmp_path / "board.png")
    page = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    assert page is not None
    rows = page[round(2480 - 14 * DOTS_PER_MM) : round(2480 - 12 * DOTS_PER_MM)]
    length = max(
        np.diff(np.flatnonzero(np.diff((row > 128).astype(int)))).max()
        for row in rows
        if (row < 128).any()
    )
    assert length / DOTS_PER_MM == pytest.approx(100.0, abs=0.3)


@pytest.mark.parametrize(("suffix", "begin"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_it_can_be_a_vector_drawing(suffix: str, begin: bytes, tmp_path: Path) -> None:
    file = tmp_path / f"board.{suffix}"
    print_board(CHESSBOARD, file)
    assert file.read_bytes().startswith(begin)


@pytest.mark.parametrize(
    ("layout", "name"),
    [
        (BoardLayout(10, 7, 0.035), "A3"),
        (BoardLayout(6, 9, 0.025), "A4"),
        (BoardLayout(10, 7, 0.1), "1016 x 729 mm"),
    ],
)
def test_the_smallest_suitable_paper_is_named(layout: BoardLayout, name: str) -> None:
    assert choose_paper(Chessboard(layout))[0] == name
