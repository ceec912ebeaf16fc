"""The files of an occupancy grid: a map of Nav2's map_server (pgm and yaml), and a picture."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.recording.image_encoding import ColorFormat, encode_image
from vo_service.types.occupancy_grid import FREE, OCCUPIED, OccupancyGrid

IMAGE_SUFFIX, SETTINGS_SUFFIX = ".pgm", ".yaml"
# Gray values. An unknown cell has an occupancy of (255 - 205) / 255 = 0.1961, so the threshold of
# free cells has to be below it.
FREE_GRAY, OCCUPIED_GRAY, UNKNOWN_GRAY = 254, 0, 205
FREE_THRESHOLD, OCCUPIED_THRESHOLD = 0.196, 0.65
# Pixels of the picture along the side of a cell.
PICTURE_SCALE = 4


def encode_grid_image(grid: OccupancyGrid) -> bytes:
    """Encode the cells as a PGM file; its first row is the upper one, with the largest y."""
    image = _gray(grid)
    height, width = image.shape
    return b"P5\n%d %d\n255\n" % (width, height) + image.tobytes()


def encode_grid_settings(grid: OccupancyGrid, image_name: str) -> bytes:
    """Encode the YAML file that map_server loads, for an image of this name beside it."""
    x, y = grid.origin_xy_m
    lines = [
        f"image: {image_name}",
        "mode: trinary",
        f"resolution: {grid.resolution_m:g}",
        f"origin: [{x:.6g}, {y:.6g}, 0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESHOLD}",
        f"free_thresh: {FREE_THRESHOLD}",
    ]
    return ("\n".join(lines) + "\n").encode()


def encode_grid_picture(grid: OccupancyGrid) -> bytes:
    """Encode a PNG picture for people: y up, a cell has several pixels."""
    scale = np.ones((PICTURE_SCALE, PICTURE_SCALE), np.uint8)
    return encode_image(np.kron(_gray(grid), scale), ColorFormat.PNG)


def write_grid_image(path: Path, grid: OccupancyGrid) -> None:
    """Write the PGM file. Raises OSError."""
    path.write_bytes(encode_grid_image(grid))


def write_grid_settings(path: Path, grid: OccupancyGrid) -> None:
    """Write the YAML file, for the image with the same name. Raises OSError."""
    path.write_bytes(encode_grid_settings(grid, path.with_suffix(IMAGE_SUFFIX).name))


def _gray(grid: OccupancyGrid) -> NDArray[np.uint8]:
    image = np.full(grid.cells.shape, UNKNOWN_GRAY, np.uint8)
    image[grid.cells == FREE] = FREE_GRAY
    image[grid.cells == OCCUPIED] = OCCUPIED_GRAY
    return np.ascontiguousarray(image[::-1])
