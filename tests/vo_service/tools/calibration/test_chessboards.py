"""Chessboards and ChArUco boards are found in images, and their options are checked."""

import cv2
import numpy as np
import pytest
from cv2 import aruco
from numpy.typing import NDArray

from drivers.core import InputError
from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.tools.calibration.rendered_boards import (
    COLOR_LENS,
    RenderedKinect,
    random_board_poses,
)
from vo_service.tools.calibration.board import Board, BoardCorners, BoardLayout
from vo_service.tools.calibration.chessboards import Charuco, Chessboard, make_board

CHESSBOARD = Chessboard(BoardLayout(10, 7, 0.035))
CHARUCO = Charuco(BoardLayout(8, 6, 0.045), 0.031, "4X4_100")
STRAIGHT = rigid_transform(np.eye(3), [-0.17, -0.12, 0.7])


def gray_image(board: Board, T_color_board: Array) -> NDArray[np.uint8]:
    return RenderedKinect().take_snapshot(board, T_color_board, seed=0).gray


def error_px(corners: BoardCorners, T_color_board: Array) -> Array:
    true = COLOR_LENS.project(T_color_board, corners.points_m)
    # A symmetric board may be detected upside down.
    orders = (corners.pixels - true, corners.pixels[::-1] - true)
    errors = [np.linalg.norm(order, axis=1) for order in orders]
    return min(errors, key=lambda each: float(each.mean()))


@pytest.mark.parametrize("seed", range(4))
def test_all_corners_of_a_chessboard_are_found(seed: int) -> None:
    (T,) = random_board_poses(CHESSBOARD, 1, seed)
    errors = error_px(CHESSBOARD.find_corners(gray_image(CHESSBOARD, T)), T)
    assert len(errors) == 54
    assert np.sqrt((errors**2).mean()) < 0.15


def test_a_charuco_board_is_found_with_half_of_it_outside() -> None:
    T = rigid_transform(so3_exp([0.2, 0.3, 0.1]), [0.05, -0.12, 0.6])
    corners = CHARUCO.find_corners(gray_image(CHARUCO, T))
    assert 12 <= len(corners.pixels) < 35
    errors = np.linalg.norm(corners.pixels - COLOR_LENS.project(T, corners.points_m), axis=1)
    assert np.median(errors) < 0.12


def test_a_charuco_board_of_older_opencv_versions_is_found() -> None:
    legacy_board = aruco.CharucoBoard((8, 6), 0.045, 0.031, aruco.getPredefinedDictionary(0))
    legacy_board.setLegacyPattern(True)
    image = np.asarray(legacy_board.generateImage((640, 480), marginSize=40), np.uint8)
    board = Charuco(CHARUCO.layout, CHARUCO.marker_m, "4X4_50")
    assert len(board.find_corners(image).pixels) == 35


@pytest.mark.parametrize("seed", range(6))
def test_noise_is_neither_a_board_of_few_corners_nor_another_board(seed: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 256, (15, 20), dtype=np.uint8)
    image = np.asarray(cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC), np.uint8)
    assert not len(Chessboard(BoardLayout(4, 4, 0.035)).find_corners(image).pixels)
    assert CHESSBOARD.suggest_other_board(image) == ""


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO])
def test_a_board_too_far_away_has_no_corners(board: Board) -> None:
    T = rigid_transform(np.eye(3), [-0.17, -0.12, 4.0])
    assert not len(board.find_corners(gray_image(board, T)).pixels)


def test_another_chessboard_is_suggested_as_an_option() -> None:
    other = Chessboard(BoardLayout(9, 7, 0.035))
    image = gray_image(CHESSBOARD, STRAIGHT)
    assert not len(other.find_corners(image).pixels)
    assert other.suggest_other_board(image) == "chessboard:9x6"
    assert CHESSBOARD.suggest_other_board(image) == ""


def test_another_dictionary_is_suggested_as_an_option() -> None:
    other = Charuco(CHARUCO.layout, CHARUCO.marker_m, "6X6_50")
    image = gray_image(CHARUCO, rigid_transform(np.eye(3), [-0.17, -0.12, 0.6]))
    assert not len(other.find_corners(image).pixels)
    assert other.suggest_other_board(image).startswith("charuco:8x6 --dictionary 4X4_")


def test_a_board_with_more_markers_than_its_dictionary_is_rejected() -> None:
    with pytest.raises(InputError, match="has 50 markers, the board needs 60"):
        Charuco(BoardLayout(12, 10, 0.02), 0.014, "4X4_50")


def test_a_chessboard_is_given_by_its_inner_corners_and_a_charuco_board_by_its_squares() -> None:
    board = make_board("chessboard:9x6", 0.025, None, "4X4_100")
    assert (board.layout.columns, board.layout.rows) == (10, 7)
    assert board.name == "chessboard of 9x6 inner corners"
    charuco = make_board("charuco:8x6", 0.04, None, "4X4_100")
    assert isinstance(charuco, Charuco)
    assert (charuco.layout.columns, charuco.layout.rows, charuco.marker_m) == (8, 6, 0.7 * 0.04)


@pytest.mark.parametrize(
    ("name", "square_m", "marker_m", "dictionary", "message"),
    [
        ("chess:9x6", 0.025, None, "4X4_100", "chess:9x6: is not a board; write chessb"),
        ("chessboard:9", 0.025, None, "4X4_100", "chessboard:9: is not a board"),
        ("chessboard:9x2", 0.025, None, "4X4_100", "use 3 to 100 columns and rows"),
        ("charuco:8x6", 0.04, 0.04, "4X4_100", "must be smaller than the square"),
        ("charuco:8x6", 0.04, None, "9X9", "--dictionary 9X9: is unknown; use one"),
    ],
)
def test_a_wrong_option_is_named(
    name: str, square_m: float, marker_m: float | None, dictionary: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        make_board(name, square_m, marker_m, dictionary)
    assert message in str(caught.value)
