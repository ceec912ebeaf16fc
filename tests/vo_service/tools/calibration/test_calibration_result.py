"""Camera file, table and figure of a calibration."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.calibration import read_calibration
from tests.vo_service.tools.calibration.board_snapshots import BOARD
from vo_service.tools.calibration.calibration_result import CalibrationResult
from vo_service.tools.calibration.collect_folder import RAW_CALIBRATION
from vo_service.tools.calibration.color_camera import ColorCalibrationResult
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.output_files import save_camera_file
from vo_service.tools.calibration.plot import draw_plot, write_plot

pytestmark = pytest.mark.slow


@pytest.fixture
def calibration(color: ColorCalibrationResult, depth: DepthCalibrationResult) -> CalibrationResult:
    known = replace(RAW_CALIBRATION, readout_s=0.02)
    return CalibrationResult(BOARD, known, color, [depth], ["a warning"])


def test_the_camera_file_has_the_result(calibration: CalibrationResult, tmp_path: Path) -> None:
    save_camera_file(tmp_path / "camera.toml", calibration.camera_calibration, "a heading")
    read = read_calibration(tmp_path / "camera.toml")
    assert read == calibration.camera_calibration
    assert (read.depth_factor, read.readout_s) == (1000.0, 0.02)
    assert read.fx == pytest.approx(calibration.color.lens.fx, abs=1e-4)
    assert read.depth is not None
    model = calibration.depth[0].model
    np.testing.assert_allclose(read.depth.T_color_depth.matrix, model.T_color_depth, atol=1e-6)
    assert (read.depth.width, read.depth.height) == (640, 480)
    assert read.depth.fx == pytest.approx(model.lens.fx, abs=1e-4)
    assert read.depth.scale == pytest.approx(model.scale, abs=1e-6)


def test_a_file_behind_a_link_is_written_at_its_target(
    calibration: CalibrationResult, tmp_path: Path
) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / "camera.toml"
    link.symlink_to(tmp_path / "real" / "camera.toml")
    save_camera_file(link, calibration.camera_calibration, "heading")
    assert link.is_symlink()
    assert read_calibration(tmp_path / "real" / "camera.toml") == calibration.camera_calibration


def test_the_table_shows_both_cameras(calibration: CalibrationResult) -> None:
    table = calibration.as_table()
    lens, depth = calibration.color.lens, calibration.depth[0]
    (row,) = [line for line in table.splitlines() if line.startswith("fx (px)")]
    assert f"{lens.fx:.2f} ± " in row
    assert f"{depth.model.lens.fx:.2f} ± " in row
    assert f"{depth.model.scale:.4f} ± " in table
    assert all(line == line.rstrip() for line in table.splitlines())


def test_the_json_has_numbers(calibration: CalibrationResult) -> None:
    content = json.loads(json.dumps(calibration.as_json()))
    assert content["color"]["fx"] == calibration.color.lens.fx
    assert set(content["color"]["sigma"]) == {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"}
    assert content["depth"]["translation_m"][0] == pytest.approx(-0.025, abs=0.002)
    assert content["warnings"] == ["a warning"]


def test_the_figure_has_two_plots_per_camera(
    calibration: CalibrationResult, tmp_path: Path
) -> None:
    titles = [plot.get_title() for plot in draw_plot(calibration).axes]
    assert titles[0].startswith("corners, and 0.")
    assert titles[2].startswith("depth readings on the boards")
    write_plot(tmp_path / "coverage.png", calibration)
    assert cv2.imread(str(tmp_path / "coverage.png")) is not None
