"""Depth readings on the board, each with the plane of its board."""

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
        views: V views.
        T_camera_board: (V, 4, 4) poses of the boards in the frame of the color camera.
        layout: Layout of the board.
        model: Depth camera, for the outlines.
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
