"""Calibration of both cameras from views."""

from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.calibration_result import CalibrationResult
from vo_service.tools.calibration.collect_folder import CollectedViews
from vo_service.tools.calibration.color_camera import calibrate_color
from vo_service.tools.calibration.depth_camera import calibrate_depth
from vo_service.tools.calibration.validation import validate_color, validate_depth


def solve_calibration(
    board: Board, collected: CollectedViews, with_depth: bool, terminal: Terminal
) -> CalibrationResult:
    """Fit the color camera, then the depth camera to it, if that is wanted.

    Raises:
        UserFacingError: There are too few or too similar views, or the result is not valid.
    """
    with terminal.busy("fitting the color camera"):
        color = calibrate_color(collected.views)
    warnings = validate_color(color, collected.gaps)
    fits = []
    if with_depth:
        with terminal.busy("fitting the depth camera") as busy:
            factor = collected.known.depth_factor
            depth = calibrate_depth(color, board.layout, factor, busy.progress_callback("step"))
        warnings += validate_depth(depth, color, collected.gaps)
        fits.append(depth)
    warnings += [gap.problem for gap in collected.gaps]
    return CalibrationResult(board, collected.known, color, fits, warnings)
