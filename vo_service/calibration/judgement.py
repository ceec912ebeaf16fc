"""Whether a calibration may be used: a camera file that is wrong is worse than none."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drivers.errors import UserFacingError
from drivers.geometry import Array
from vo_service.calibration.colour_camera import ColourCalibration
from vo_service.calibration.depth_camera import DepthCalibration
from vo_service.calibration.depth_model import SHIFT, TURN
from vo_service.calibration.guidance import Lack

# Largest standard deviations that are saved; what is above half of one is told.
FOCAL_PERCENT = 0.5
CENTRE_PX = 2.0
TURN_DEG = 0.3
SHIFT_MM = 5.0
SCALE_PERCENT = 0.5
# Corners of a flat board that is still are found to a tenth of a pixel.
LARGE_ERROR_PX = 0.7
FEW_VIEWS = 15
# Two cameras are at least so far apart, or the depth is registered already.
NEAREST_CAMERAS_M = 0.008
SAME_FOCAL = 0.01


@dataclass(frozen=True)
class Certainty:
    """One figure's standard deviation and the largest that is good enough."""

    name: str
    sigma: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} ±{self.sigma:.2g} {self.unit} (at most {self.limit:g})"


def check_colour(colour: ColourCalibration, lacks: Iterable[Lack]) -> list[str]:
    """Warnings. Raises UserFacingError if the views do not determine the camera."""
    warnings = _judged("colour", _lens(colour.lens.fx, colour.lens.fy, colour.sigma), lacks)
    if len(colour.views) < FEW_VIEWS:
        warnings.append(f"only {len(colour.views)} views: 25 make a calibration that lasts")
    if colour.rms_px > LARGE_ERROR_PX:
        warnings.append(
            f"corners are {colour.rms_px:.2f} px off: put the board on something flat and stiff, "
            "hold it still, and see that --board and --square are right"
        )
    return warnings


def check_depth(
    depth: DepthCalibration, colour: ColourCalibration, lacks: Iterable[Lack]
) -> list[str]:
    """Warnings. Raises UserFacingError if the result is not to be used."""
    model = depth.model
    gap_m = float(np.linalg.norm(model.vector[SHIFT]))
    same_lens = abs(model.lens.fx / colour.lens.fx - 1.0) < SAME_FOCAL
    if gap_m < NEAREST_CAMERAS_M and same_lens:
        raise UserFacingError(
            f"this depth is registered to colour already (its camera would be {1e3 * gap_m:.0f} mm "
            "from the colour camera); leave out --depth, or record with --depth --keep"
        )
    return _judged("depth", _depth_figures(depth), lacks)


def _lens(fx: float, fy: float, sigma: Array) -> list[Certainty]:
    return [
        Certainty("focal length", 100 * max(sigma[0] / fx, sigma[1] / fy), FOCAL_PERCENT, "%"),
        Certainty("principal point", float(max(sigma[2:4])), CENTRE_PX, "px"),
    ]


def _depth_figures(depth: DepthCalibration) -> list[Certainty]:
    sigma, lens = depth.sigma, depth.model.lens
    turn_deg = float(np.degrees(np.linalg.norm(sigma[TURN])))
    shift_mm = 1e3 * float(np.linalg.norm(sigma[SHIFT]))
    return [
        *_lens(lens.fx, lens.fy, sigma),
        Certainty("angle between the cameras", turn_deg, TURN_DEG, "deg"),
        Certainty("offset of the cameras", shift_mm, SHIFT_MM, "mm"),
        Certainty("scale", 100 * float(sigma[-1]), SCALE_PERCENT, "%"),
    ]


def _judged(camera: str, figures: list[Certainty], lacks: Iterable[Lack]) -> list[str]:
    """Warnings about what is not certain. Raises UserFacingError if it is too little."""
    remedies = [lack.remedy for lack in lacks] or ["take more views, each different"]
    bad = [str(figure) for figure in figures if not figure.sigma <= figure.limit]
    if bad:
        raise UserFacingError(
            f"nothing is saved: the views do not determine the {camera} camera: {', '.join(bad)}; "
            f"{'; '.join(remedies[:3])}"
        )
    return [
        f"the {camera} camera's {figure.name} is known to ±{figure.sigma:.2g} {figure.unit} only"
        for figure in figures
        if figure.sigma > figure.limit / 2
    ]
