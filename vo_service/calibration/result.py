"""A whole calibration: the camera file it becomes, and how it is told to people and programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.camera_file import CameraFile, DepthTable, RigidPose
from drivers.geometry import Array, rotation_vector
from vo_service.calibration.board import Board
from vo_service.calibration.colour_camera import ColourCalibration
from vo_service.calibration.depth_camera import DepthCalibration
from vo_service.calibration.depth_model import SCALE, SHIFT, TURN
from vo_service.calibration.folder import DepthUnits
from vo_service.calibration.snapshot import Lens

COLUMN = "{:<26}{:>24}{:>24}"
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
# Far below any standard deviation, and easier to read than sixteen digits.
PIXEL_DIGITS, COEFFICIENT_DIGITS, METRE_DIGITS, TURN_DIGITS = 4, 7, 6, 9


@dataclass(frozen=True)
class Calibration:
    """What was found; `depth` is empty where it was not asked for."""

    board: Board
    units: DepthUnits
    colour: ColourCalibration
    depth: Sequence[DepthCalibration]
    warnings: list[str]

    @property
    def camera_file(self) -> CameraFile:
        """Rounded to what can be read."""
        lens, (width, height) = self.colour.lens, self.colour.size
        fx, fy, cx, cy = (round(v, PIXEL_DIGITS) for v in (lens.fx, lens.fy, lens.cx, lens.cy))
        k1, k2, p1, p2, k3 = (round(k, COEFFICIENT_DIGITS) for k in lens.distortion)
        tables = [_rounded(depth.table) for depth in self.depth]
        return CameraFile(
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
            tables[0] if tables else None,
        )

    def as_table(self) -> str:
        """For people."""
        colour = self.colour
        width, height = colour.size
        count = f"{len(colour.views)} views of a {self.board.name}"
        rows = [f"{count}, {width}x{height}", ""]
        rows.append(COLUMN.format("", "colour camera", "depth camera" if self.depth else ""))
        figures = [_column(colour.lens, colour.sigma)]
        figures += [_column(d.model.lens, d.sigma[:6]) for d in self.depth]
        for number, name in enumerate(("fx", "fy", "cx", "cy", *COEFFICIENTS)):
            unit = " (px)" if number < 4 else ""
            cells = [column[number] for column in figures]
            rows.append(COLUMN.format(name + unit, *cells, *[""] * (2 - len(cells))))
        errors = [f"{colour.rms_px:.3f} px", *(f"{1e3 * d.rms_m:.2f} mm" for d in self.depth)]
        rows.append(COLUMN.format("error (rms)", *errors, *[""] * (2 - len(errors))))
        rows += [line for depth in self.depth for line in _pose_lines(depth)]
        return "\n".join(row.rstrip() for row in rows)

    def as_json(self) -> dict[str, Any]:
        """For programs; keys stay."""
        colour = self.colour
        return {
            "board": self.board.name,
            "image": list(colour.size),
            "views": len(colour.views),
            "rejected": colour.rejected,
            "warnings": self.warnings,
            "colour": _lens_json(colour.lens, colour.sigma) | {"rms_px": float(colour.rms_px)},
            "depth": _depth_json(self.depth[0]) if self.depth else None,
        }


def _rounded(table: DepthTable) -> DepthTable:
    x, y, z = (round(v, METRE_DIGITS) for v in table.T_color_depth.translation_m)
    qx, qy, qz, qw = (round(q, TURN_DIGITS) for q in table.T_color_depth.quaternion_xyzw)
    k1, k2, p1, p2, k3 = (round(k, COEFFICIENT_DIGITS) for k in table.distortion)
    fx, fy, cx, cy = (round(v, PIXEL_DIGITS) for v in (table.fx, table.fy, table.cx, table.cy))
    return DepthTable(
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        T_color_depth=RigidPose((x, y, z), (qx, qy, qz, qw)),
        distortion=(k1, k2, p1, p2, k3),
        width=table.width,
        height=table.height,
        scale=round(table.scale, METRE_DIGITS),
    )


def _column(lens: Lens, sigma: Array) -> list[str]:
    """Nine cells; a coefficient that the views do not tell is "-"."""
    sigmas = np.append(sigma, np.zeros(9 - len(sigma)))
    cells = zip(lens.vector, sigmas, [2] * 4 + [4] * 5, strict=True)
    return [f"{v:.{d}f} ± {s:.{d}f}" if s else "-" for v, s, d in cells]


def _pose_lines(depth: DepthCalibration) -> list[str]:
    vector, sigma = depth.model.vector, depth.sigma
    shift = _axes(1e3 * vector[SHIFT], 1e3 * sigma[SHIFT])
    turn = _axes(np.degrees(vector[TURN]), np.degrees(sigma[TURN]))
    return [
        "",
        "from the depth camera to the colour camera (T_color_depth)",
        f"  shift (mm)  {shift}",
        f"  turn (deg)  {turn}",
        f"true distance per distance read (scale)  {depth.model.scale:.4f} ± {sigma[SCALE]:.4f}",
    ]


def _axes(values: Array, sigma: Array) -> str:
    cells = zip("xyz", values, sigma, strict=True)
    return "   ".join(f"{axis} {value:7.2f} ± {s:.2f}" for axis, value, s in cells)


def _lens_json(lens: Lens, sigma: Array) -> dict[str, Any]:
    return {
        "fx": lens.fx,
        "fy": lens.fy,
        "cx": lens.cx,
        "cy": lens.cy,
        "distortion": list(lens.distortion),
        "sigma": dict(zip(("fx", "fy", "cx", "cy", *COEFFICIENTS), sigma.tolist(), strict=False)),
    }


def _depth_json(depth: DepthCalibration) -> dict[str, Any]:
    model, sigma = depth.model, depth.sigma
    return _lens_json(model.lens, sigma[:6]) | {
        "views": depth.view_count,
        "rms_mm": 1e3 * depth.rms_m,
        "scale": model.scale,
        "scale_sigma": float(sigma[SCALE]),
        "translation_m": model.vector[SHIFT].tolist(),
        "translation_sigma_m": sigma[SHIFT].tolist(),
        "rotation_vector_rad": rotation_vector(model.T_color_depth[:3, :3]).tolist(),
        "rotation_sigma_rad": sigma[TURN].tolist(),
    }
