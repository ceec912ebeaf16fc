"""Result of a calibration: the camera file's values, a table, and JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from drivers.calibration import CameraCalibration, DepthCameraCalibration, RigidTransform
from drivers.core.geometry import Array, quaternion_from_rotation
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.color_camera import ColorCalibrationResult
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.depth_model import ROTATION, SCALE_INDEX, TRANSLATION
from vo_service.tools.calibration.lens import Lens

ROW_FORMAT = "{:<26}{:>24}{:>24}"
LENS_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
# Far below any standard deviation, and readable.
PIXEL_DIGITS, COEFFICIENT_DIGITS, METER_DIGITS, QUATERNION_DIGITS = 4, 7, 6, 9


@dataclass(frozen=True)
class CalibrationResult:
    """Calibrated cameras; `depth` is empty without a depth camera.

    `known` has the depth factor and the timing, which a board does not show.
    """

    board: Board
    known: CameraCalibration
    color: ColorCalibrationResult
    depth: Sequence[DepthCalibrationResult]
    warnings: list[str]

    @property
    def camera_calibration(self) -> CameraCalibration:
        """Calibration with readable, rounded values."""
        width, height = self.color.size
        tables = [_round_depth(depth) for depth in self.depth]
        return replace(
            self.known,
            width=width,
            height=height,
            **_round_lens(self.color.lens),
            depth=tables[0] if tables else None,
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
        for number, name in enumerate(LENS_PARAMETERS):
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


def _round_lens(lens: Lens) -> dict[str, Any]:
    pixels = {name: round(getattr(lens, name), PIXEL_DIGITS) for name in ("fx", "fy", "cx", "cy")}
    return pixels | {"distortion": tuple(round(k, COEFFICIENT_DIGITS) for k in lens.distortion)}


def _round_depth(depth: DepthCalibrationResult) -> DepthCameraCalibration:
    T_color_depth = depth.model.T_color_depth
    x, y, z = T_color_depth[:3, 3].round(METER_DIGITS).tolist()
    quaternion_xyzw = quaternion_from_rotation(T_color_depth[:3, :3])
    qx, qy, qz, qw = quaternion_xyzw.round(QUATERNION_DIGITS).tolist()
    height, width = depth.pixels.shape
    return DepthCameraCalibration(
        **_round_lens(depth.model.lens),
        T_color_depth=RigidTransform((x, y, z), (qx, qy, qz, qw)),
        width=width,
        height=height,
        scale=round(depth.model.scale, METER_DIGITS),
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
    return asdict(lens) | {"sigma": dict(zip(LENS_PARAMETERS, sigma.tolist(), strict=False))}


def _depth_as_json(depth: DepthCalibrationResult) -> dict[str, Any]:
    model, sigma = depth.model, depth.sigma
    return _lens_as_json(model.lens, sigma[:6]) | {
        "views": depth.view_count,
        "rms_mm": 1e3 * depth.rms_m,
        "scale": model.scale,
        "scale_sigma": float(sigma[SCALE_INDEX]),
        "translation_m": model.vector[TRANSLATION].tolist(),
        "translation_sigma_m": sigma[TRANSLATION].tolist(),
        "rotation_vector_rad": model.vector[ROTATION].tolist(),
        "rotation_sigma_rad": sigma[ROTATION].tolist(),
    }
