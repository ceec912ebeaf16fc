"""The cells that one frame tells of: occupied, free, and floor, in the camera's level frame.

Every reading of an obstacle marks its cell. A cell is free only if the whole height of the band was
looked through there: between the range at which the lowest ray has come down to the least height,
and the nearest reading above it. What a camera only looked over is not free: it erases no table.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.jit import kernel
from vo_service.navigation.depth_rays import (
    STRIDE,
    DepthRays,
    HeightBand,
    make_depth_rays,
    read_only,
)
from vo_service.navigation.level_view import LevelView

# Directions all around: those of a camera that looks down steeply are anywhere.
BINS = 720
STEP_RAD = 2.0 * np.pi / BINS
# Used pixels that make a cell occupied, or floor.
MIN_OBSTACLE_PIXELS, MIN_FLOOR_PIXELS = 2, 4
# A reading up to this far from the floor is floor.
FLOOR_HEIGHT_M = 0.05


class CellKind(IntEnum):
    """What a frame tells of a cell."""

    FREE = 0
    OCCUPIED = 1
    FLOOR = 2


# (N, 3) int16: column and row of a cell, and its kind. The cell (0, 0) has its middle below the
# camera; columns grow forward, rows to the left.
LocalCells = NDArray[np.int16]
NO_CELLS: LocalCells = np.empty((0, 3), np.int16)


def local_cells(
    frame: RgbdFrame, view: LevelView, band: HeightBand, resolution_m: float
) -> LocalCells:
    """Return the cells that a frame tells of, up to the band's largest range."""
    rays = _level_rays(frame.camera, view)
    reach = int(np.ceil(band.range_max_m / resolution_m))
    size = 2 * reach + 1
    pixels = np.zeros((2, size, size), np.uint16)  # obstacles, floor
    is_free = np.zeros((size, size), np.bool_)
    _fill(
        read_only(frame.depth_raw),
        np.float32(1.0 / frame.depth_factor),
        rays,
        band,
        np.float32(resolution_m),
        pixels,
        is_free,
    )
    kinds = np.full((size, size), -1, np.int16)
    kinds[pixels[1] >= MIN_FLOOR_PIXELS] = CellKind.FLOOR
    kinds[is_free] = CellKind.FREE
    kinds[pixels[0] >= MIN_OBSTACLE_PIXELS] = CellKind.OCCUPIED
    columns, rows = np.nonzero(kinds >= 0)
    cells = np.stack([columns - reach, rows - reach, kinds[columns, rows]], axis=1)
    return cells.astype(np.int16)


def _level_rays(camera: PinholeCamera, view: LevelView) -> DepthRays:
    return make_depth_rays(camera, view.R_level_camera, -np.pi, STEP_RAD, BINS)


@kernel
def _fill(
    depth_raw: NDArray[np.uint16],
    meters: np.float32,
    rays: DepthRays,
    band: HeightBand,
    resolution_m: np.float32,
    pixels: NDArray[np.uint16],
    is_free: NDArray[np.bool_],
) -> None:
    """Count pixels with an obstacle or floor, and mark the cells that are looked through.

    Args:
        pixels: (2, size, size) zeros; by column and row.
        is_free: (size, size) False.
    """
    camera_m, min_m, rise = np.float32(band.camera_m), np.float32(band.min_m), np.float32(band.rise)
    top_m, most_m = np.float32(band.max_m), np.float32(band.range_max_m)
    middle = pixels.shape[1] // 2
    lowest = np.full(BINS, np.inf, np.float32)  # slope of the lowest ray with a reading
    nearest = np.full(BINS, np.inf, np.float32)  # reading at or above the least height
    farthest = np.zeros(BINS, np.float32)  # reading that the band was looked through for
    for i in range(rays.bin.shape[0]):
        for j in range(rays.bin.shape[1]):
            z = depth_raw[i * STRIDE, j * STRIDE] * meters
            number = rays.bin[i, j]
            if z == 0 or number < 0:
                continue
            range_m = z * rays.horizontal[i, j]
            height_m = camera_m + z * rays.vertical[i, j]
            lowest[number] = min(lowest[number], rays.vertical[i, j] / rays.horizontal[i, j])
            if height_m <= max(top_m, camera_m):
                farthest[number] = max(farthest[number], range_m)
            is_above_floor = height_m >= min_m + range_m * rise
            if is_above_floor and height_m <= max(top_m, camera_m):
                nearest[number] = min(nearest[number], range_m)
            is_obstacle = is_above_floor and height_m <= top_m
            is_floor = abs(height_m) <= FLOOR_HEIGHT_M
            if range_m >= most_m or not (is_obstacle or is_floor):
                continue
            angle = number * STEP_RAD - np.pi
            column = middle + int(np.floor(range_m * np.cos(angle) / resolution_m + 0.5))
            row = middle + int(np.floor(range_m * np.sin(angle) / resolution_m + 0.5))
            pixels[0 if is_obstacle else 1, column, row] += 1
    for number in range(BINS):
        if lowest[number] >= rise:
            continue
        angle = number * STEP_RAD - np.pi
        range_m = (camera_m - min_m) / (rise - lowest[number])
        end_m = min(nearest[number] - resolution_m, farthest[number], most_m)
        while range_m < end_m:
            column = middle + int(np.floor(range_m * np.cos(angle) / resolution_m + 0.5))
            row = middle + int(np.floor(range_m * np.sin(angle) / resolution_m + 0.5))
            is_free[column, row] = True
            range_m += np.float32(0.5) * resolution_m
