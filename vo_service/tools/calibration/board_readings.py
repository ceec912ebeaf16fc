"""The depth readings that lie on the board, and the plane that each must lie in."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse
from vo_service.tools.calibration.board import BoardLayout
from vo_service.tools.calibration.depth_model import DepthModel
from vo_service.tools.calibration.snapshot import BoardView

MAX_READINGS_PER_VIEW = 150
MIN_READINGS_PER_VIEW = 40


@dataclass(frozen=True)
class BoardReadings:
    """Readings on boards, one row each; planes are n . x = offset in the color camera.

    shape       (height, width) of the depth images
    view        (N,) number of the view
    pixels      (N, 2) column and row
    readings_m  (N,) as the sensor has them
    normals     (N, 3)
    offsets_m   (N,)
    """

    shape: tuple[int, int]
    view_number: NDArray[np.int64]
    pixels: Array
    readings_m: Array
    normals: Array
    offsets_m: Array

    def residuals_m(self, model: DepthModel) -> Array:
        """(N,) signed distances of the readings from their boards' planes."""
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
    """Collect them, with the board outlined in each depth image as `model` has it.

    T_camera_board (V, 4, 4) is where the color camera saw the boards. Views with too few readings
    give none.
    """
    rows: list[Array] = []
    for number, (view, T) in enumerate(zip(views, T_camera_board, strict=True)):
        column_row = _sample_pixels(view.depth_raw, model, T, layout)
        if len(column_row) < MIN_READINGS_PER_VIEW:
            continue
        readings_m = view.depth_raw[column_row[:, 1], column_row[:, 0]] / depth_factor
        normal = T[:3, 2]
        plane = np.tile([*normal, normal @ T[:3, 3]], (len(column_row), 1))
        which = np.full(len(column_row), number)
        rows.append(np.column_stack([which, column_row, readings_m, plane]))
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
    """(N, 2) columns and rows of readings on the board, thinned to an even grid."""
    T_depth_board = inverse(model.T_color_depth) @ T_camera_board
    corners_px = model.lens.project(T_depth_board, layout.inner_rectangle_m)
    on_board = np.zeros(depth_raw.shape, np.uint8)
    cv2.fillConvexPoly(on_board, np.rint(corners_px).astype(np.int32), 1)
    on_board[depth_raw == 0] = 0
    step = max(1, math.ceil(math.sqrt(cv2.countNonZero(on_board) / MAX_READINGS_PER_VIEW)))
    rows, columns = np.nonzero(on_board[::step, ::step])
    return step * np.column_stack([columns, rows])
