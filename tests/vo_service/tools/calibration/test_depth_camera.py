"""Calibration of the depth camera from planes with a Kinect's noise and quantization."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.core import UserFacingError
from drivers.core.geometry import inverse, rotation_angle_rad
from tests.vo_service.tools.calibration.board_snapshots import BOARD
from tests.vo_service.tools.calibration.rendered_boards import (
    COLOR_LENS,
    DEPTH_LENS,
    T_COLOR_DEPTH,
    RenderedKinect,
    random_board_poses,
)
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult, calibrate_depth
from vo_service.tools.calibration.validation import validate_depth

TRUE_SCALE = RenderedKinect().depth_scale


def ignore_progress(done: int, total: int) -> None:
    pass


def test_lens_pose_and_scale_are_accurate(depth: DepthCalibrationResult) -> None:
    lens = depth.model.lens
    assert [lens.fx, lens.fy] == pytest.approx([DEPTH_LENS.fx, DEPTH_LENS.fy], rel=0.005)
    assert [lens.cx, lens.cy] == pytest.approx([DEPTH_LENS.cx, DEPTH_LENS.cy], abs=1.0)
    error = inverse(T_COLOR_DEPTH) @ depth.model.T_color_depth
    assert np.linalg.norm(error[:3, 3]) < 0.002
    assert np.degrees(rotation_angle_rad(error[:3, :3])) < 0.2
    assert depth.model.scale == pytest.approx(TRUE_SCALE, rel=0.005)
    assert lens.distortion == (0.0, 0.0, 0.0, 0.0, 0.0)


def test_the_standard_deviations_have_the_size_of_the_errors(depth: DepthCalibrationResult) -> None:
    true = np.array([DEPTH_LENS.fx, DEPTH_LENS.fy, DEPTH_LENS.cx, DEPTH_LENS.cy])
    assert np.all(np.abs(depth.model.vector[:4] - true) < 4 * depth.sigma[:4])
    assert abs(depth.model.scale - TRUE_SCALE) < 4 * depth.sigma[-1]
    assert np.all(depth.sigma[:4] < 1.0)


def test_the_residuals_are_the_sensors_noise(depth: DepthCalibrationResult) -> None:
    assert 0.0005 < depth.rms_m < 0.003
    assert depth.is_used.mean() > 0.99
    assert abs(float(np.median(depth.residuals_m))) < 0.0005


@pytest.mark.slow
@pytest.mark.usefixtures("few_jackknife_groups")
def test_a_distorted_lens_is_accurate_in_the_whole_image() -> None:
    distorted = RenderedKinect(depth=replace(DEPTH_LENS, distortion=(-0.12, 0.2, 0.0, 0.0, 0.0)))
    color = calibrate_color(distorted.make_views(BOARD, random_board_poses(BOARD, 24, 6)))
    lens = calibrate_depth(color, BOARD.layout, 1000.0, ignore_progress).model.lens
    rays = np.column_stack([*np.mgrid[-0.5:0.5:8j, -0.4:0.4:8j].reshape(2, -1), np.ones(64)])
    shift = lens.project(np.eye(4), rays) - distorted.depth.project(np.eye(4), rays)
    assert lens.distortion[0] < -0.05
    assert np.linalg.norm(shift, axis=1).max() < 2.0


def _change_depth(
    color: ColorCalibrationResult, change: Callable[[NDArray[np.uint16]], NDArray[np.uint16]]
) -> ColorCalibrationResult:
    views = [replace(view, depth_raw=change(view.depth_raw)) for view in color.views]
    return replace(color, views=views)


@pytest.mark.slow
@pytest.mark.usefixtures("few_jackknife_groups")
def test_readings_beside_the_board_are_left_out(color: ColorCalibrationResult) -> None:
    def add_near_object(depth_raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
        changed = depth_raw.copy()
        changed[200:260, 250:330] = 500
        return changed

    result = calibrate_depth(
        _change_depth(color, add_near_object), BOARD.layout, 1000.0, ignore_progress
    )
    assert result.model.lens.fx == pytest.approx(DEPTH_LENS.fx, rel=0.005)
    assert result.model.scale == pytest.approx(TRUE_SCALE, rel=0.005)


def test_no_depth_on_the_board_is_rejected(color: ColorCalibrationResult) -> None:
    with pytest.raises(UserFacingError, match=r"only 0 of \d+ views have depth readings"):
        calibrate_depth(_change_depth(color, np.zeros_like), BOARD.layout, 1000.0, ignore_progress)


@pytest.mark.slow
def test_a_few_views_are_fitted_and_counted() -> None:
    color = calibrate_color(RenderedKinect().make_views(BOARD, random_board_poses(BOARD, 8, 4)))
    few = calibrate_depth(color, BOARD.layout, 1000.0, ignore_progress)
    assert np.all(few.sigma[:4] > 0.0)
    assert few.view_count == 8


@pytest.mark.usefixtures("few_jackknife_groups")
def test_depth_of_another_scene_is_rejected(color: ColorCalibrationResult) -> None:
    depths = [view.depth_raw for view in color.views]
    views = [
        replace(view, depth_raw=depth_raw)
        for view, depth_raw in zip(color.views, [*depths[1:], depths[0]], strict=True)
    ]
    with pytest.raises(UserFacingError, match=r"depth does not agree with the boards|times as far"):
        calibrate_depth(replace(color, views=views), BOARD.layout, 1000.0, ignore_progress)


@pytest.mark.slow
@pytest.mark.usefixtures("few_jackknife_groups")
def test_depth_that_is_registered_to_color_is_rejected() -> None:
    same = RenderedKinect(depth=COLOR_LENS, T_color_depth=np.eye(4))
    color = calibrate_color(same.make_views(BOARD, random_board_poses(BOARD, 12, 4)))
    result = calibrate_depth(color, BOARD.layout, 1000.0, ignore_progress)
    with pytest.raises(UserFacingError, match="already registered to color"):
        validate_depth(result, color, [])
