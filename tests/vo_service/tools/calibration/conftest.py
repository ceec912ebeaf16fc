"""Rendered snapshots of a board and their calibration, shared by all tests."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.shared_fixture import make_once
from tests.vo_service.tools.calibration.board_snapshots import (
    BOARD,
    each_image_is_searched_once,
    load_snapshots,
    set_jackknife_groups,
)
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult, calibrate_depth
from vo_service.tools.calibration.snapshot import Snapshot
from vo_service.tools.calibration.view_selection import ViewSelector


@pytest.fixture
def few_jackknife_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few fits of standard deviations."""
    set_jackknife_groups(monkeypatch, 5)


CalibratedKinect = tuple[ViewSelector, ColorCalibrationResult, DepthCalibrationResult]
FILE = "calibrated.pickle"


@pytest.fixture(scope="session")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Snapshots of the board in many places, color and depth."""
    return load_snapshots(tmp_path_factory)


@pytest.fixture(scope="session")
def calibrated_kinect(
    photographs: Sequence[Snapshot], tmp_path_factory: pytest.TempPathFactory
) -> CalibratedKinect:
    """Views and calibration, computed once for all processes of pytest."""

    def calibrate(folder: Path) -> None:
        selector = ViewSelector(BOARD)
        with each_image_is_searched_once(tmp_path_factory):
            for snapshot in photographs:
                selector.process(snapshot)
        color = calibrate_color(selector.views)
        depth = calibrate_depth(color, BOARD.layout, 1000.0, lambda done, total: None)
        (folder / FILE).write_bytes(pickle.dumps((selector, color, depth)))

    folder = make_once(tmp_path_factory, "calibrated", calibrate)
    result: CalibratedKinect = pickle.loads((folder / FILE).read_bytes())
    return result


@pytest.fixture(scope="session")
def selector(calibrated_kinect: CalibratedKinect) -> ViewSelector:
    """The view selector after all snapshots."""
    return calibrated_kinect[0]


@pytest.fixture(scope="session")
def color(calibrated_kinect: CalibratedKinect) -> ColorCalibrationResult:
    """The color camera, calibrated from the snapshots."""
    return calibrated_kinect[1]


@pytest.fixture(scope="session")
def depth(calibrated_kinect: CalibratedKinect) -> DepthCalibrationResult:
    """The depth camera, calibrated from the snapshots."""
    return calibrated_kinect[2]
