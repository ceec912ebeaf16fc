"""The color camera from rendered boards."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from tests.vo_service.tools.calibration.rendered_boards import (
    COLOR_LENS,
    RenderedKinect,
    random_board_poses,
)
from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.chessboard import Chessboard
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.snapshot import BoardView, Lens
from vo_service.tools.calibration.view_selection import ViewSelector

NO_BEND = replace(COLOR_LENS, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def intrinsics(lens: Lens) -> Array:
    return np.array([lens.fx, lens.fy, lens.cx, lens.cy])


def moved(view: BoardView, shift_px: Array) -> BoardView:
    return replace(
        view, corners=BoardCorners(view.corners.pixels + shift_px, view.corners.points_m)
    )


def test_intrinsics_are_found_within_a_pixel_and_half_a_per_cent(
    color: ColorCalibrationResult,
) -> None:
    error = intrinsics(color.lens) - intrinsics(COLOR_LENS)
    assert np.all(np.abs(error[:2]) < 0.005 * intrinsics(COLOR_LENS)[:2])
    assert np.all(np.abs(error[2:]) < 1.0)
    assert color.rms_px < 0.15
    assert color.rejected == []


def test_rays_go_within_a_pixel_of_where_they_should_all_over_the_image(
    color: ColorCalibrationResult,
) -> None:
    x, y = np.meshgrid(np.linspace(-0.55, 0.55, 12), np.linspace(-0.42, 0.42, 10))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    found, true = color.lens.project(np.eye(4), rays), COLOR_LENS.project(np.eye(4), rays)
    assert np.linalg.norm(found - true, axis=1).max() < 1.0


def test_the_standard_deviations_are_the_errors_order_of_size(
    color: ColorCalibrationResult,
) -> None:
    error = np.abs(intrinsics(color.lens) - intrinsics(COLOR_LENS))
    assert np.all(error < 4 * color.sigma[:4])
    assert np.all(color.sigma[:4] < 1.0)


def test_a_coefficient_that_cannot_be_told_is_left_out(board: Chessboard) -> None:
    found = calibrate_color(
        RenderedKinect(color=NO_BEND).make_views(board, random_board_poses(board, 15, 1))
    )
    assert found.lens.distortion[-1] == 0.0


def test_a_board_that_moved_is_left_out_and_named(picker: ViewSelector) -> None:
    bent = np.zeros((54, 2))
    bent[::2] = 3.0
    views = [*picker.views[:14], moved(replace(picker.views[14], name="wrong"), bent)]
    found = calibrate_color(views)
    assert found.rejected == ["wrong"]
    assert found.rms_px < 0.15


def test_a_corner_behind_a_finger_is_left_out(picker: ViewSelector) -> None:
    wrong = np.zeros((54, 2))
    wrong[17] = (1.0, -0.6)
    found = calibrate_color([*picker.views[:19], moved(picker.views[19], wrong)])
    assert len(found.views) == 20
    assert len(found.views[-1].corners.pixels) == 53


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_views_are_refused(picker: ViewSelector, count: int) -> None:
    with pytest.raises(UserFacingError, match=f"only {count} different views .* at least 6"):
        calibrate_color(picker.views[:count])


def test_views_may_show_different_corners(picker: ViewSelector) -> None:
    partly = [
        replace(v, corners=BoardCorners(v.corners.pixels[n % 7 :], v.corners.points_m[n % 7 :]))
        for n, v in enumerate(picker.views)
    ]
    error = intrinsics(calibrate_color(partly).lens) - intrinsics(COLOR_LENS)
    assert np.abs(error).max() < 1.0
