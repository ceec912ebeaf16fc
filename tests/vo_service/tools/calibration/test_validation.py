"""Views that do not determine the camera are refused, with what to do."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.errors import UserFacingError
from drivers.core.geometry import rigid_transform
from tests.vo_service.tools.calibration.rendered_boards import RenderedKinect
from vo_service.tools.calibration.chessboard import Chessboard
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.coverage import CoverageGap, find_coverage_gaps
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.validation import validate_color, validate_depth
from vo_service.tools.calibration.view_selection import estimate_board_pose


def test_good_views_give_no_warning(
    color: ColorCalibrationResult, depth: DepthCalibrationResult
) -> None:
    assert validate_color(color, []) == []
    assert validate_depth(depth, color, []) == []


@pytest.mark.slow
def test_boards_that_all_face_the_camera_are_refused_with_what_to_do(board: Chessboard) -> None:
    places = [(x, y, z) for x in (-0.25, -0.1) for y in (-0.2, -0.05) for z in (0.8, 1.0, 1.2)]
    views = RenderedKinect().make_views(
        board, [rigid_transform(np.eye(3), place) for place in places]
    )
    lacking = find_coverage_gaps(
        views, [estimate_board_pose(view) for view in views], with_depth=False
    )
    with pytest.raises(UserFacingError) as caught:
        validate_color(calibrate_color(views), lacking)
    assert "do not determine the color camera: focal length ±" in str(caught.value)
    assert "tilt its left edge" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_known_badly_is_told(color: ColorCalibrationResult) -> None:
    sigma = color.sigma.copy()
    sigma[2] = 1.5
    (warning,) = validate_color(replace(color, sigma=sigma), [])
    assert warning == "the color camera's principal point is known to ±1.5 px only"


def test_few_views_and_large_errors_are_told(color: ColorCalibrationResult) -> None:
    few = replace(color, views=color.views[:8], rms_px=1.3)
    warnings = validate_color(few, [])
    assert warnings[0].startswith("only 8 views")
    assert warnings[1].startswith("corners are 1.30 px off: put the board on something flat")


@pytest.mark.parametrize("place", [0, 6, 9, 12])
def test_depth_that_is_not_determined_is_refused(
    place: int, color: ColorCalibrationResult, depth: DepthCalibrationResult
) -> None:
    sigma = depth.sigma.copy()
    sigma[place] = 20.0 if place == 0 else 0.02
    lack = CoverageGap("", "hold it nearer")
    with pytest.raises(UserFacingError, match=r"nothing is saved: .* the depth camera.* nearer"):
        validate_depth(replace(depth, sigma=sigma), color, [lack])


def test_a_figure_that_could_not_be_had_is_refused(color: ColorCalibrationResult) -> None:
    sigma = np.full(9, np.nan)
    with pytest.raises(UserFacingError, match="nothing is saved"):
        validate_color(replace(color, sigma=sigma), [])
