"""One Kinect before one board, rendered and calibrated once."""

from collections.abc import Sequence

import pytest

from tests.vo_service.calibration.photographs import BOARD, take_photographs
from vo_service.calibration.chessboard import Chessboard
from vo_service.calibration.colour_camera import ColourCalibration, calibrate_colour
from vo_service.calibration.depth_camera import DepthCalibration, calibrate_depth
from vo_service.calibration.picking import ViewPicker
from vo_service.calibration.snapshot import Snapshot


@pytest.fixture(scope="session")
def board() -> Chessboard:
    """A chessboard on A3."""
    return BOARD


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Of the board in many places, colour and depth."""
    return take_photographs(tmp_path_factory)


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
