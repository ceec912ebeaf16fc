"""Model of a depth camera with thirteen parameters, and its readings on boards."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, transform_points
from vo_service.tools.calibration.board import BoardLayout
from vo_service.tools.calibration.lens import Lens
from vo_service.tools.calibration.snapshot import BoardView

PARAMETER_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "rx", "ry", "rz", "tx", "ty", "tz", "scale")
DISTORTION = slice(4, 6)
ROTATION = slice(6, 9)
TRANSLATION = slice(9, 12)
SCALE_INDEX = 12
# Kinect and Xtion: ratio of infrared focal length and image width; the color camera is 25 mm to
# the right of the infrared camera.
DEFAULT_FOCAL_RATIO = 575.8 / 640.0
DEFAULT_TRANSLATION_M = (-0.025, 0.0, 0.0)
MAX_READINGS_PER_VIEW = 150
MIN_READINGS_PER_VIEW = 40


@dataclass(frozen=True)
class DepthModel:
    """Depth camera; `vector` (13,) has `PARAMETER_NAMES`, rotation as axis-angle (rad), meters."""

    vector: Array

    @classmethod
    def default(cls, size: tuple[int, int], scale: float) -> Self:
        """Return a typical Kinect's depth camera for an image size (width, height)."""
        width, height = size
        focal_px = DEFAULT_FOCAL_RATIO * width
        undistorted_lens = [focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, 0.0, 0.0]
        no_rotation = [0.0] * 3
        return cls(np.array([*undistorted_lens, *no_rotation, *DEFAULT_TRANSLATION_M, scale]))

    def with_parameters(self, indices: NDArray[np.int64], values: Array) -> "DepthModel":
        """Return a copy with changed parameters; `indices` are positions in `vector`."""
        vector = self.vector.copy()
        vector[indices] = values
        return DepthModel(vector)

    @property
    def T_color_depth(self) -> Array:
        """4x4 transform from the depth camera's frame to the color camera's."""
        return rigid_transform(so3_exp(self.vector[ROTATION]), self.vector[TRANSLATION])

    @property
    def scale(self) -> float:
        """True distance divided by the reading."""
        return float(self.vector[SCALE_INDEX])

    @property
    def lens(self) -> Lens:
        """Intrinsics and distortion."""
        fx, fy, cx, cy, k1, k2 = (float(value) for value in self.vector[:6])
        return Lens(fx, fy, cx, cy, (k1, k2, 0.0, 0.0, 0.0))

    def points_m(self, pixels: Array, readings_m: Array) -> Array:
        """Return points (N, 3) in the color camera's frame of readings (N,) at pixels (N, 2)."""
        points = self.lens.rays(pixels) * (self.scale * readings_m)[:, None]
        return transform_points(self.T_color_depth, points)


@dataclass(frozen=True)
class BoardReadings:
    """N depth readings on boards; planes are n . x = offset in the frame of the color camera.

    Attributes:
        shape: (height, width) of the depth images.
        view_number: (N,) number of the view.
        pixels: (N, 2) column and row.
        readings_m: (N,) uncorrected readings of the sensor.
        normals: (N, 3) normals of the boards.
        offsets_m: (N,) offsets of the boards.
    """

    shape: tuple[int, int]
    view_number: NDArray[np.int64]
    pixels: Array
    readings_m: Array
    normals: Array
    offsets_m: Array

    def residuals_m(self, model: DepthModel) -> Array:
        """Return signed distances (N,) of the readings from their boards' planes, m."""
        points_m = model.points_m(self.pixels, self.readings_m)
        residuals: Array = (points_m * self.normals).sum(axis=1) - self.offsets_m
        return residuals


def collect_board_readings(
    views: Sequence[BoardView],
    T_camera_board: Array,
    layout: BoardLayout,
    model: DepthModel,
    depth_factor: float,
) -> BoardReadings:
    """Collect the readings inside the board's outline in each depth image.

    Views with too few readings are left out.

    Args:
        T_camera_board: (V, 4, 4) poses of the boards in the frame of the color camera.
        depth_factor: Values of the depth images per meter.
    """
    rows: list[Array] = []
    for number, (view, T) in enumerate(zip(views, T_camera_board, strict=True)):
        columns_rows = _sample_pixels(view.depth_raw, model, T, layout)
        if len(columns_rows) < MIN_READINGS_PER_VIEW:
            continue
        readings_m = view.depth_raw[columns_rows[:, 1], columns_rows[:, 0]] / depth_factor
        normal = T[:3, 2]
        plane = np.tile([*normal, normal @ T[:3, 3]], (len(columns_rows), 1))
        numbers = np.full(len(columns_rows), number)
        rows.append(np.column_stack([numbers, columns_rows, readings_m, plane]))
    table = np.concatenate(rows) if rows else np.empty((0, 8))
    return BoardReadings(
        views[0].depth_raw.shape,
        table[:, 0].astype(np.int64),
        table[:, 1:3],
        table[:, 3],
        table[:, 4:7],
        table[:, 7],
    )


def _sample_pixels(
    depth_raw: NDArray[np.uint16], model: DepthModel, T_camera_board: Array, layout: BoardLayout
) -> NDArray[np.int64]:
    """Return columns and rows (N, 2) of readings on the board, subsampled to an even grid."""
    T_depth_board = inverse(model.T_color_depth) @ T_camera_board
    corners_px = model.lens.project(T_depth_board, layout.inner_rectangle_m)
    on_board = np.zeros(depth_raw.shape, np.uint8)
    cv2.fillConvexPoly(on_board, np.rint(corners_px).astype(np.int32), 1)
    on_board[depth_raw == 0] = 0
    step = max(1, math.ceil(math.sqrt(cv2.countNonZero(on_board) / MAX_READINGS_PER_VIEW)))
    rows, columns = np.nonzero(on_board[::step, ::step])
    return step * np.column_stack([columns, rows])
