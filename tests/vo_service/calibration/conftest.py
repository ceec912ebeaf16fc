"""One Kinect before one board, rendered and calibrated once."""

from collections.abc import Sequence

import pytest

from tests.vo_service.calibration.rendered_boards import snapshots, stances
from vo_service.calibration.board import Layout
from vo_service.calibration.chessboard import Chessboard
from vo_service.calibration.colour_camera import ColourCalibration, calibrate_colour
from vo_service.calibration.depth_camera import DepthCalibration, calibrate_depth
from vo_service.calibration.picking import ViewPicker
from vo_service.calibration.snapshot import Snapshot

VIEWS = 26
# Boards of this seed reach every part of the image.
SEED = 4


@pytest.fixture(scope="session")
def board() -> Chessboard:
    """A chessboard on A3."""
    return Chessboard(Layout(10, 7, 0.035))


@pytest.fixture(scope="session")
def photographs(board: Chessboard) -> list[Snapshot]:
    """Of the board in many places, colour and depth."""
    return snapshots(board, stances(board, VIEWS, SEED), with_depth=True)


@pytest.fixture(scope="session")
def picker(board: Chessboard, photographs: Sequence[Snapshot]) -> ViewPicker:
    """After all photographs."""
    picker = ViewPicker(board)
    for photograph in photographs:
        picker.offer(photograph)
    return picker


@pytest.fixture(scope="session")
def colour(picker: ViewPicker) -> ColourCalibration:
    """The colour camera from the photographs."""
    return calibrate_colour(picker.views)


@pytest.fixture(scope="session")
def depth(colour: ColourCalibration, board: Chessboard) -> DepthCalibration:
    """The depth camera from the photographs."""
    return calibrate_depth(colour, board.layout, 1000.0, lambda done, total: None)
