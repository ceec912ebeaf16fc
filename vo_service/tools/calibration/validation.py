"""Validation of a calibration: warnings, and errors if a parameter is too uncertain."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drivers.core import UserFacingError
from drivers.core.geometry import Array
from vo_service.tools.calibration.color_camera import ColorCalibrationResult
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.depth_model import ROTATION, TRANSLATION
from vo_service.tools.calibration.view_selection import CoverageGap

# Maximum standard deviations of a saved calibration; above half of one there is a warning.
MAX_FOCAL_SIGMA_PERCENT = 0.5
MAX_CENTER_SIGMA_PX = 2.0
MAX_ROTATION_SIGMA_DEG = 0.3
MAX_TRANSLATION_SIGMA_MM = 5.0
MAX_SCALE_SIGMA_PERCENT = 0.5
# Corners of a flat, still board are accurate to a tenth of a pixel.
MAX_GOOD_RMS_PX = 0.7
MIN_GOOD_VIEWS = 15
# With a smaller distance of the two cameras, the depth is already registered.
MIN_CAMERA_DISTANCE_M = 0.008
MAX_SAME_FOCAL_RATIO = 0.01


@dataclass(frozen=True)
class ParameterUncertainty:
    """Standard deviation of one parameter, and its limit."""

    name: str
    sigma: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} ±{self.sigma:.2g} {self.unit} (at most {self.limit:g})"


def validate_color(color: ColorCalibrationResult, gaps: Iterable[CoverageGap]) -> list[str]:
    """Return warnings.

    Raises:
        UserFacingError: If the views do not determine the camera.
    """
    warnings = _check_uncertainties(
        "color", _lens_uncertainties(color.lens.fx, color.lens.fy, color.sigma), gaps
    )
    if len(color.views) < MIN_GOOD_VIEWS:
        warnings.append(f"only {len(color.views)} views; use 25 for a reliable calibration")
    if color.rms_px > MAX_GOOD_RMS_PX:
        warnings.append(
            f"the error of the corners is {color.rms_px:.2f} px; fix the board to something flat "
            "and stiff, hold it still, and check --board and --square"
        )
    return warnings


def validate_depth(
    depth: DepthCalibrationResult, color: ColorCalibrationResult, gaps: Iterable[CoverageGap]
) -> list[str]:
    """Return warnings.

    Raises:
        UserFacingError: If the result is not valid.
    """
    model = depth.model
    distance_m = float(np.linalg.norm(model.vector[TRANSLATION]))
    same_lens = abs(model.lens.fx / color.lens.fx - 1.0) < MAX_SAME_FOCAL_RATIO
    if distance_m < MIN_CAMERA_DISTANCE_M and same_lens:
        raise UserFacingError(
            "this depth is already registered to color (its camera would be "
            f"{1e3 * distance_m:.0f} mm from the color camera); leave out --depth, or record with "
            "--depth --keep"
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
    rotation_deg = float(np.degrees(np.linalg.norm(sigma[ROTATION])))
    translation_mm = 1e3 * float(np.linalg.norm(sigma[TRANSLATION]))
    return [
        *_lens_uncertainties(lens.fx, lens.fy, sigma),
        ParameterUncertainty(
            "angle between the cameras", rotation_deg, MAX_ROTATION_SIGMA_DEG, "deg"
        ),
        ParameterUncertainty(
            "offset of the cameras", translation_mm, MAX_TRANSLATION_SIGMA_MM, "mm"
        ),
        ParameterUncertainty("scale", 100 * float(sigma[-1]), MAX_SCALE_SIGMA_PERCENT, "%"),
    ]


def _check_uncertainties(
    camera: str, uncertainties: list[ParameterUncertainty], gaps: Iterable[CoverageGap]
) -> list[str]:
    """Return warnings for uncertain parameters. Raises UserFacingError above a limit."""
    remedies = [gap.remedy for gap in gaps] or ["take more views, each different"]
    bad = [str(parameter) for parameter in uncertainties if not parameter.sigma <= parameter.limit]
    if bad:
        raise UserFacingError(
            f"nothing is saved: the views do not determine the {camera} camera: {', '.join(bad)}; "
            f"{'; '.join(remedies[:3])}"
        )
    return [
        f"the {camera} camera's {parameter.name} is uncertain: "
        f"±{parameter.sigma:.2g} {parameter.unit}"
        for parameter in uncertainties
        if parameter.sigma > parameter.limit / 2
    ]
