"""One Kinect before one board, rendered and calibrated once."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.made_once import made_once
from tests.vo_service.calibration.photographs import (
    BOARD,
    each_image_is_searched_once,
    take_photographs,
)
from vo_service.calibration.chessboard import Chessboard
from vo_service.calibration.colour_camera import ColourCalibration, calibrate_colour
from vo_service.calibration.depth_camera import DepthCalibration, calibrate_depth
from vo_service.calibration.picking import ViewPicker
from vo_service.calibration.snapshot import Snapshot

Calibrated = tuple[ViewPicker, ColourCalibration, DepthCalibration]
FILE = "calibrated.pickle"


@pytest.fixture(scope="session")
def board() -> Chessboard:
    """A chessboard on A3."""
    return BOARD


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Of the board in many places, colour and depth."""
    return take_photographs(tmp_path_factory)


@pytest.fixture(scope="session")
def calibrated(
    board: Chessboard,
    photographs: Sequence[Snapshot],
    tmp_path_factory: pytest.TempPathFactory,
) -> Calibrated:
    """Found and fitted once for all of pytest's processes."""

    def calibrate(folder: Path) -> None:
        picker = ViewPicker(board)
        with each_image_is_searched_once(tmp_path_factory):
            for photograph in photographs:
                picker.offer(photograph)
        colour = calibrate_colour(picker.views)
        depth = calibrate_depth(colour, board.layout, 1000.0, lambda done, total: None)
        (folder / FILE).write_bytes(pickle.dumps((picker, colour, depth)))

    folder = made_once(tmp_path_factory, "calibrated", calibrate)
    found: Calibrated = pickle.loads((folder / FILE).read_bytes())
    return found


@pytest.fixture(scope="session")
def picker(calibrated: Calibrated) -> ViewPicker:
    """After all photographs."""
    return calibrated[0]


@pytest.fixture(scope="session")
def colour(calibrated: Calibrated) -> ColourCalibration:
    """The colour camera from the photographs."""
    return calibrated[1]


@pytest.fixture(scope="session")
def depth(calibrated: Calibrated) -> DepthCalibration:
    """The depth camera from the photographs."""
    return calibrated[2]
