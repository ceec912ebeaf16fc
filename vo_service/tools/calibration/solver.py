"""Calibration of both cameras from views, their validation, and the result as a table and JSON."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.calibration import CameraCalibration, DepthCameraCalibration, RigidTransform
from drivers.core import UserFacingError
from drivers.core.geometry import Array, so3_log
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.collect_folder import CollectedViews, DepthUnits
from vo_service.tools.calibration.color_camera import ColorCalibrationResult, calibrate_color
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult, calibrate_depth
from vo_service.tools.calibration.depth_model import ROTATION, SCALE_INDEX, TRANSLATION
from vo_service.tools.calibration.lens import Lens
from vo_service.tools.calibration.view_selection import CoverageGap

ROW_FORMAT = "{:<26}{:>24}{:>24}"
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
# Far below any standard deviation, and readable.
PIXEL_DIGITS, COEFFICIENT_DIGITS, METER_DIGITS, QUATERNION_DIGITS = 4, 7, 6, 9


@dataclass(frozen=True)
class CalibrationResult:
    """Calibrated cameras; `depth` is empty without a depth camera."""

    board: Board
    units: DepthUnits
    color: ColorCalibrationResult
    depth: Sequence[DepthCalibrationResult]
    warnings: list[str]

    @property
    def camera_calibration(self) -> CameraCalibration:
        """Calibration with readable, rounded values."""
        lens, (width, height) = self.color.lens, self.color.size
        fx, fy, cx, cy = (round(v, PIXEL_DIGITS) for v in (lens.fx, lens.fy, lens.cx, lens.cy))
        k1, k2, p1, p2, k3 = (round(k, COEFFICIENT_DIGITS) for k in lens.distortion)
        tables = [_round_depth_calibration(depth.calibration) for depth in self.depth]
        return CameraCalibration(
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            (k1, k2, p1, p2, k3),
            self.units.depth_factor,
            self.units.readout_s,
            self.units.depth_offset_s,
            depth=tables[0] if tables else None,
            readout_sigma_s=self.units.readout_sigma_s,
            depth_offset_sigma_s=self.units.depth_offset_sigma_s,
        )

    def as_table(self) -> str:
        """Return a table for people."""
        color = self.color
        width, height = color.size
        count = f"{len(color.views)} views of a {self.board.name}"
        rows = [f"{count}, {width}x{height}", ""]
        rows.append(ROW_FORMAT.format("", "color camera", "depth camera" if self.depth else ""))
        columns = [_format_column(color.lens, color.sigma)]
        columns += [_format_column(d.model.lens, d.sigma[:6]) for d in self.depth]
        for number, name in enumerate(("fx", "fy", "cx", "cy", *COEFFICIENTS)):
            unit = " (px)" if number < 4 else ""
            cells = [column[number] for column in columns]
            rows.append(ROW_FORMAT.format(name + unit, *cells, *[""] * (2 - len(cells))))
        errors = [f"{color.rms_px:.3f} px", *(f"{1e3 * d.rms_m:.2f} mm" for d in self.depth)]
        rows.append(ROW_FORMAT.format("error (rms)", *errors, *[""] * (2 - len(errors))))
        rows += [line for depth in self.depth for line in _format_pose(depth)]
        return "\n".join(row.rstrip() for row in rows)

    def as_json(self) -> dict[str, Any]:
        """Return the result for programs; the keys are stable."""
        color = self.color
        return {
            "board": self.board.name,
            "image": list(color.size),
            "views": len(color.views),
            "rejected": color.rejected,
            "warnings": self.warnings,
            "color": _lens_as_json(color.lens, color.sigma) | {"rms_px": float(color.rms_px)},
            "depth": _depth_as_json(self.depth[0]) if self.depth else None,
        }


def _round_depth_calibration(calibration: DepthCameraCalibration) -> DepthCameraCalibration:
    x, y, z = (round(v, METER_DIGITS) for v in calibration.T_color_depth.translation_m)
    qx, qy, qz, qw = (
        round(q, QUATERNION_DIGITS) for q in calibration.T_color_depth.quaternion_xyzw
    )
    k1, k2, p1, p2, k3 = (round(k, COEFFICIENT_DIGITS) for k in calibration.distortion)
    fx, fy, cx, cy = (
        round(v, PIXEL_DIGITS)
        for v in (calibration.fx, calibration.fy, calibration.cx, calibration.cy)
    )
    return DepthCameraCalibration(
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        T_color_depth=RigidTransform((x, y, z), (qx, qy, qz, qw)),
        distortion=(k1, k2, p1, p2, k3),
        width=calibration.width,
        height=calibration.height,
        scale=round(calibration.scale, METER_DIGITS),
    )


def _format_column(lens: Lens, sigma: Array) -> list[str]:
    """Return nine cells; "-" for a coefficient that was not fitted."""
    sigmas = np.append(sigma, np.zeros(9 - len(sigma)))
    cells = zip(lens.vector, sigmas, [2] * 4 + [4] * 5, strict=True)
    return [f"{v:.{d}f} ± {s:.{d}f}" if s else "-" for v, s, d in cells]


def _format_pose(depth: DepthCalibrationResult) -> list[str]:
    vector, sigma = depth.model.vector, depth.sigma
    translation = _format_axes(1e3 * vector[TRANSLATION], 1e3 * sigma[TRANSLATION])
    rotation = _format_axes(np.degrees(vector[ROTATION]), np.degrees(sigma[ROTATION]))
    scale = f"{depth.model.scale:.4f} ± {sigma[SCALE_INDEX]:.4f}"
    return [
        "",
        "from the depth camera to the color camera (T_color_depth)",
        f"  translation (mm)  {translation}",
        f"  rotation (deg)    {rotation}",
        f"true distance per measured distance (scale)  {scale}",
    ]


def _format_axes(values: Array, sigma: Array) -> str:
    cells = zip("xyz", values, sigma, strict=True)
    return "   ".join(f"{axis} {value:7.2f} ± {s:.2f}" for axis, value, s in cells)


def _lens_as_json(lens: Lens, sigma: Array) -> dict[str, Any]:
    return {
        "fx": lens.fx,
        "fy": lens.fy,
        "cx": lens.cx,
        "cy": lens.cy,
        "distortion": list(lens.distortion),
        "sigma": dict(zip(("fx", "fy", "cx", "cy", *COEFFICIENTS), sigma.tolist(), strict=False)),
    }


def _depth_as_json(depth: DepthCalibrationResult) -> dict[str, Any]:
    model, sigma = depth.model, depth.sigma
    return _lens_as_json(model.lens, sigma[:6]) | {
        "views": depth.view_count,
        "rms_mm": 1e3 * depth.rms_m,
        "scale": model.scale,
        "scale_sigma": float(sigma[SCALE_INDEX]),
        "translation_m": model.vector[TRANSLATION].tolist(),
        "translation_sigma_m": sigma[TRANSLATION].tolist(),
        "rotation_vector_rad": so3_log(model.T_color_depth[:3, :3]).tolist(),
        "rotation_sigma_rad": sigma[ROTATION].tolist(),
    }


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

    Args:
        depth: The fitted depth camera.
        color: The fitted color camera.
        gaps: Gaps in the coverage of the views.

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


def solve_calibration(
    board: Board, collected: CollectedViews, with_depth: bool, terminal: Terminal
) -> CalibrationResult:
    """Fit the color camera, then the depth camera to it.

    Args:
        board: The board.
        collected: Views of the board.
        with_depth: Whether to calibrate the depth camera.
        terminal: Shows the progress.

    Raises:
        UserFacingError: There are too few or too similar views, or the result is not valid.
    """
    with terminal.busy("fitting the color camera"):
        color = calibrate_color(collected.views)
    warnings = validate_color(color, collected.gaps)
    fits = []
    if with_depth:
        with terminal.busy("fitting the depth camera") as busy:
            factor = collected.units.depth_factor
            depth = calibrate_depth(color, board.layout, factor, busy.progress_callback("step"))
        warnings += validate_depth(depth, color, collected.gaps)
        fits.append(depth)
    warnings += [gap.problem for gap in collected.gaps]
    return CalibrationResult(board, collected.units, color, fits, warnings)
