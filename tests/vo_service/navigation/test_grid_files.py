"""Files of an occupancy grid, as Nav2's map_server reads them."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from ruamel.yaml import YAML

from vo_service.navigation.grid_files import (
    encode_grid_image,
    encode_grid_picture,
    encode_grid_settings,
)
from vo_service.types.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

values = st.sampled_from([FREE, OCCUPIED, UNKNOWN])
grids = arrays(np.int8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=values)


def decode(data: bytes) -> NDArray[np.uint8]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image.astype(np.uint8)


@given(grids, st.floats(-100.0, 100.0), st.floats(-100.0, 100.0))
def test_map_server_reads_back_every_cell(cells: NDArray[np.int8], x: float, y: float) -> None:
    grid = OccupancyGrid(cells, 0.05, (x, y))
    settings = YAML(typ="safe").load(encode_grid_settings(grid, "map.pgm").decode())
    np.testing.assert_allclose(settings["origin"], (x, y, 0.0), rtol=1e-5, atol=1e-5)
    assert (settings["resolution"], settings["image"]) == (0.05, "map.pgm")
    # As map_server's trinary mode: row 0 is the upper one.
    occupancy = (255.0 - decode(encode_grid_image(grid))[::-1]) / 255.0
    read = np.full(cells.shape, UNKNOWN, np.int8)
    read[occupancy > settings["occupied_thresh"]] = OCCUPIED
    read[occupancy < settings["free_thresh"]] = FREE
    np.testing.assert_array_equal(read, cells)


def test_the_picture_has_y_up() -> None:
    cells = np.array([[FREE, UNKNOWN], [OCCUPIED, UNKNOWN]], np.int8)
    picture = decode(encode_grid_picture(OccupancyGrid(cells)))
    assert picture.shape == (8, 8)
    assert (picture[0, 0], picture[-1, 0], picture[0, -1]) == (0, 254, 205)
