"""Whether a calibration may be used: a camera file that is wrong is worse than none."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from vo_service.tools.calibration.color_camera import ColorCalibrationResult
from vo_service.tools.calibration.coverage import CoverageGap
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.depth_model import ROTATION, TRANSLATION

# Largest standard deviations that are saved; what is above half of one is told.
MAX_FOCAL_SIGMA_PERCENT = 0.5
MAX_CENTER_SIGMA_PX = 2.0
MAX_ROTATION_SIGMA_DEG = 0.3
MAX_TRANSLATION_SIGMA_MM = 5.0
MAX_SCALE_SIGMA_PERCENT = 0.5
# Corners of a flat board that is still are found to a tenth of a pixel.
MAX_GOOD_RMS_PX = 0.7
MIN_GOOD_VIEWS = 15
# Two cameras are at least so far apart, or the depth is registered already.
MIN_CAMERA_DISTANCE_M = 0.008
MAX_SAME_FOCAL_RATIO = 0.01


@dataclass(frozen=True)
class ParameterUncertainty:
    """One figure's standard deviation and the largest that is good enough."""

    name: str
    sigma: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} ±{self.sigma:.2g} {self.unit} (at most {self.limit:g})"


def validate_color(color: ColorCalibrationResult, gaps: Iterable[CoverageGap]) -> list[str]:
    """Warnings. Raises UserFacingError if the views do not determine the camera."""
    warnings = _check_uncertainties(
        "color", _lens_uncertainties(color.lens.fx, color.lens.fy, color.sigma), gaps
    )
    if len(color.views) < MIN_GOOD_VIEWS:
        warnings.append(f"only {len(color.views)} views: 25 make a calibration that lasts")
    if color.rms_px > MAX_GOOD_RMS_PX:
        warnings.append(
            f"corners are {color.rms_px:.2f} px off: put the board on something flat and stiff, "
            "hold it still, and see that --board and --square are right"
        )
    return warnings


def validate_depth(
    depth: DepthCalibrationResult, color: ColorCalibrationResult, gaps: Iterable[CoverageGap]
) -> list[str]:
    """Warnings. Raises UserFacingError if the result is not to be used."""
    model = depth.model
    gap_m = float(np.linalg.norm(model.vector[TRANSLATION]))
    same_lens = abs(model.lens.fx / color.lens.fx - 1.0) < MAX_SAME_FOCAL_RATIO
    if gap_m < MIN_CAMERA_DISTANCE_M and same_lens:
        raise UserFacingError(
            f"this depth is registered to color already (its camera would be {1e3 * gap_m:.0f} mm "
            "from the color camera); leave out --depth, or record with --depth --keep"
        )
    return _check_uncertainties("depth", _depth_uncertainties(depth), gaps)


def _lens_uncertainties(fx: float, fy: float, sigma: Array) -> list[ParameterUncertainty]:
    return [
        ParameterUncertainty(
            "focal length", 100 * max(sigma[0] / fx, sigma[1] / fy), MAX_FOCAL_SIGMA_PERCENT, "%"
        ),
        ParameterUncertainty("principal point", float(max(sigma[2:4])), MAX_CENTER_SIGMA_PX, "px"),
    ]


def _depth_uncertainties(depth: DepthCalibrationResult) -> list[ParameterUncertainty]:
    sigma, lens = depth.sigma, depth.model.lens
    turn_deg = float(np.degrees(np.linalg.norm(sigma[ROTATION])))
    shift_mm = 1e3 * float(np.linalg.norm(sigma[TRANSLATION]))
    return [
        *_lens_uncertainties(lens.fx, lens.fy, sigma),
        ParameterUncertainty("angle between the cameras", turn_deg, MAX_ROTATION_SIGMA_DEG, "deg"),
        ParameterUncertainty("offset of the cameras", shift_mm, MAX_TRANSLATION_SIGMA_MM, "mm"),
        ParameterUncertainty("scale", 100 * float(sigma[-1]), MAX_SCALE_SIGMA_PERCENT, "%"),
    ]


def _check_uncertainties(
    camera: str, uncertainties: list[ParameterUncertainty], gaps: Iterable[CoverageGap]
) -> list[str]:
    """Warnings about what is not certain. Raises UserFacingError if it is too little."""
    remedies = [lack.remedy for lack in gaps] or ["take more views, each different"]
    bad = [str(figure) for figure in uncertainties if not figure.sigma <= figure.limit]
    if bad:
        raise UserFacingError(
            f"nothing is saved: the views do not determine the {camera} camera: {', '.join(bad)}; "
            f"{'; '.join(remedies[:3])}"
        )
    return [
        f"the {camera} camera's {figure.name} is known to ±{figure.sigma:.2g} {figure.unit} only"
        for figure in uncertainties
        if figure.sigma > figure.limit / 2
    ]
