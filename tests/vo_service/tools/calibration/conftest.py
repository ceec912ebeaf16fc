"""One Kinect before one board, rendered and calibrated once."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.shared_fixture import make_once
from tests.vo_service.tools.calibration.board_snapshots import (
    BOARD,
    each_image_is_searched_once,
    load_snapshots,
)
from vo_service.tools.calibration.chessboard import Chessboard
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult, calibrate_depth
from vo_service.tools.calibration.snapshot import Snapshot
from vo_service.tools.calibration.view_selection import ViewSelector

CalibratedKinect = tuple[ViewSelector, ColorCalibrationResult, DepthCalibrationResult]
FILE = "calibrated.pickle"


@pytest.fixture(scope="session")
def board() -> Chessboard:
    """A chessboard on A3."""
    return BOARD


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Of the board in many places, color and depth."""
    return load_snapshots(tmp_path_factory)


@pytest.fixture(scope="session")
def calibrated(
    board: Chessboard,
    photographs: Sequence[Snapshot],
    tmp_path_factory: pytest.TempPathFactory,
) -> CalibratedKinect:
    """Found and fitted once for all of pytest's processes."""

    def calibrate(folder: Path) -> None:
        picker = ViewSelector(board)
        with each_image_is_searched_once(tmp_path_factory):
            for photograph in photographs:
                picker.process(photograph)
        color = calibrate_color(picker.views)
        depth = calibrate_depth(color, board.layout, 1000.0, lambda done, total: None)
        (folder / FILE).write_bytes(pickle.dumps((picker, color, depth)))

    folder = make_once(tmp_path_factory, "calibrated", calibrate)
    found: CalibratedKinect = pickle.loads((folder / FILE).read_bytes())
    return found


@pytest.fixture(scope="session")
def picker(calibrated: CalibratedKinect) -> ViewSelector:
    """After all photographs."""
    return calibrated[0]


@pytest.fixture(scope="session")
def color(calibrated: CalibratedKinect) -> ColorCalibrationResult:
    """The color camera from the photographs."""
    return calibrated[1]


@pytest.fixture(scope="session")
def depth(calibrated: CalibratedKinect) -> DepthCalibrationResult:
    """The depth camera from the photographs."""
    return calibrated[2]
