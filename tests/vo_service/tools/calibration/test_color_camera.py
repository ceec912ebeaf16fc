"""Calibration of the color camera from rendered boards."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core import UserFacingError
from drivers.core.geometry import Array
from tests.vo_service.tools.calibration.board_snapshots import BOARD
from tests.vo_service.tools.calibration.rendered_boards import (
    COLOR_LENS,
    RenderedKinect,
    random_board_poses,
)
from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.color_camera import (
    ColorCalibrationResult,
    calibrate_color,
    jackknife_sigma,
)
from vo_service.tools.calibration.lens import Lens
from vo_service.tools.calibration.snapshot import BoardView
from vo_service.tools.calibration.view_selection import ViewSelector

NO_DISTORTION = replace(COLOR_LENS, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def intrinsics(lens: Lens) -> Array:
    return np.array([lens.fx, lens.fy, lens.cx, lens.cy])


def shift_corners(view: BoardView, shift_px: Array) -> BoardView:
    return replace(
        view, corners=BoardCorners(view.corners.pixels + shift_px, view.corners.points_m)
    )


def test_intrinsics_are_accurate_to_a_pixel_and_half_a_percent(
    color: ColorCalibrationResult,
) -> None:
    error = intrinsics(color.lens) - intrinsics(COLOR_LENS)
    assert np.all(np.abs(error[:2]) < 0.005 * intrinsics(COLOR_LENS)[:2])
    assert np.all(np.abs(error[2:]) < 1.0)
    assert color.rms_px < 0.15
    assert color.rejected == []


def test_projections_are_accurate_to_a_pixel_in_the_whole_image(
    color: ColorCalibrationResult,
) -> None:
    x, y = np.meshgrid(np.linspace(-0.55, 0.55, 12), np.linspace(-0.42, 0.42, 10))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    actual, true = color.lens.project(np.eye(4), rays), COLOR_LENS.project(np.eye(4), rays)
    assert np.linalg.norm(actual - true, axis=1).max() < 1.0


def test_the_standard_deviations_have_the_size_of_the_errors(color: ColorCalibrationResult) -> None:
    error = np.abs(intrinsics(color.lens) - intrinsics(COLOR_LENS))
    assert np.all(error < 4 * color.sigma[:4])
    assert np.all(color.sigma[:4] < 1.0)


@pytest.mark.usefixtures("few_jackknife_groups")
def test_an_insignificant_coefficient_is_left_out() -> None:
    result = calibrate_color(
        RenderedKinect(color=NO_DISTORTION).make_views(BOARD, random_board_poses(BOARD, 15, 1))
    )
    assert result.lens.distortion[-1] == 0.0


@pytest.mark.usefixtures("few_jackknife_groups")
def test_a_view_of_a_moved_board_is_rejected_and_named(selector: ViewSelector) -> None:
    shift_px = np.zeros((54, 2))
    shift_px[::2] = 3.0
    views = [
        *selector.views[:14],
        shift_corners(replace(selector.views[14], name="wrong"), shift_px),
    ]
    result = calibrate_color(views)
    assert result.rejected == ["wrong"]
    assert result.rms_px < 0.15


@pytest.mark.usefixtures("few_jackknife_groups")
def test_a_wrong_corner_is_left_out(selector: ViewSelector) -> None:
    shift_px = np.zeros((54, 2))
    shift_px[17] = (1.0, -0.6)
    result = calibrate_color([*selector.views[:19], shift_corners(selector.views[19], shift_px)])
    assert len(result.views) == 20
    assert len(result.views[-1].corners.pixels) == 53


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_views_are_rejected(selector: ViewSelector, count: int) -> None:
    with pytest.raises(UserFacingError, match=f"only {count} different views .* at least 6"):
        calibrate_color(selector.views[:count])


@pytest.mark.usefixtures("few_jackknife_groups")
def test_views_may_show_different_corners(selector: ViewSelector) -> None:
    partial_views = [
        replace(v, corners=BoardCorners(v.corners.pixels[n % 7 :], v.corners.points_m[n % 7 :]))
        for n, v in enumerate(selector.views)
    ]
    error = intrinsics(calibrate_color(partial_views).lens) - intrinsics(COLOR_LENS)
    assert np.abs(error).max() < 1.0


def test_the_jackknife_gives_the_standard_error_of_a_mean() -> None:
    values = np.random.default_rng(0).normal(5.0, 2.0, 40)
    fits = [np.array([np.delete(values, n).mean()]) for n in range(40)]
    expected = values.std(ddof=1) / np.sqrt(40)
    np.testing.assert_allclose(jackknife_sigma(fits), [expected])
