"""From views to a calibration that may be used."""

from vo_service.calibration.board import Board
from vo_service.calibration.colour_camera import calibrate_colour
from vo_service.calibration.depth_camera import calibrate_depth
from vo_service.calibration.judgement import check_colour, check_depth
from vo_service.calibration.result import Calibration
from vo_service.calibration.taking import Taken
from vo_service.terminal import Terminal


def solve(board: Board, taken: Taken, with_depth: bool, terminal: Terminal) -> Calibration:
    """Fit the colour camera, then the depth camera to it.

    Raises UserFacingError if the views are too few or too much alike, or the result cannot be.
    """
    with terminal.busy("fitting the colour camera"):
        colour = calibrate_colour(taken.views)
    warnings = check_colour(colour, taken.lacks)
    fits = []
    if with_depth:
        with terminal.busy("fitting the depth camera") as busy:
            factor = taken.units.depth_factor
            depth = calibrate_depth(colour, board.layout, factor, busy.counted("step"))
        warnings += check_depth(depth, colour, taken.lacks)
        fits.append(depth)
    warnings += [lack.what for lack in taken.lacks]
    return Calibration(board, taken.units, colour, fits, warnings)
