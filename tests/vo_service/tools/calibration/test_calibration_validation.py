"""Validation rejects views that do not determine the camera."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core import UserFacingError
from drivers.core.geometry import rigid_transform
from tests.vo_service.tools.calibration.board_snapshots import BOARD
from tests.vo_service.tools.calibration.rendered_boards import RenderedKinect
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.validation import validate_color, validate_depth
from vo_service.tools.calibration.view_selection import (
    CoverageGap,
    estimate_board_pose,
    find_coverage_gaps,
)


def test_good_views_give_no_warning(
    color: ColorCalibrationResult, depth: DepthCalibrationResult
) -> None:
    assert validate_color(color, []) == []
    assert validate_depth(depth, color, []) == []


@pytest.mark.slow
def test_boards_that_all_face_the_camera_are_rejected_with_instructions() -> None:
    positions = [(x, y, z) for x in (-0.25, -0.1) for y in (-0.2, -0.05) for z in (0.8, 1.0, 1.2)]
    views = RenderedKinect().make_views(
        BOARD, [rigid_transform(np.eye(3), position) for position in positions]
    )
    gaps = find_coverage_gaps(
        views, [estimate_board_pose(view) for view in views], with_depth=False
    )
    with pytest.raises(UserFacingError) as caught:
        validate_color(calibrate_color(views), gaps)
    assert "do not determine the color camera: focal length ±" in str(caught.value)
    assert "tilt its left edge" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_few_views_large_errors_and_uncertainty_give_warnings(
    color: ColorCalibrationResult,
) -> None:
    sigma = color.sigma.copy()
    sigma[2] = 1.5
    assert validate_color(replace(color, sigma=sigma), []) == [
        "the color camera's principal point is uncertain: ±1.5 px"
    ]
    few = replace(color, views=color.views[:8], rms_px=1.3)
    warnings = validate_color(few, [])
    assert warnings[0].startswith("only 8 views")
    assert warnings[1].startswith("the error of the corners is 1.30 px; fix the board")


@pytest.mark.parametrize("position", [0, 6, 9, 12])
def test_an_uncertain_depth_camera_is_rejected(
    position: int, color: ColorCalibrationResult, depth: DepthCalibrationResult
) -> None:
    sigma = depth.sigma.copy()
    sigma[position] = 20.0 if position == 0 else 0.02
    gap = CoverageGap("", "hold it nearer")
    with pytest.raises(UserFacingError, match=r"nothing is saved: .* the depth camera.* nearer"):
        validate_depth(replace(depth, sigma=sigma), color, [gap])


def test_an_unknown_uncertainty_is_rejected(color: ColorCalibrationResult) -> None:
    sigma = np.full(9, np.nan)
    with pytest.raises(UserFacingError, match="nothing is saved"):
        validate_color(replace(color, sigma=sigma), [])
