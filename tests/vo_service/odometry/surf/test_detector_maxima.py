import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.core.geometry import Array
from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES, make_blob_image
from vo_service.odometry.surf.detector import (
    NUM_COLUMNS,
    RESPONSE,
    SCALE,
    SIGN,
    LayerTriple,
    find_maxima,
    max_num_maxima,
)

LOBES = (3, 5, 7)
FIRST = 11  # of the 21x21 filter's border, and one neighbor
SIZE = 40
OFFSET = st.floats(-0.4, 0.4)  # further out, the mixed terms can lift a neighbor above


def maxima(layers: Array, threshold: float, step: int = 1) -> NDArray[np.float32]:
    """Keypoints of three layers (3, H, W); the image itself is flat."""
    rows, columns = layers.shape[1:]
    below, middle, above = layers.astype(np.float32)
    flat = np.zeros((rows * step + 1, columns * step + 1), np.int32)
    table = np.empty((max_num_maxima(rows, columns), NUM_COLUMNS), np.float32)
    found = find_maxima(
        flat, LayerTriple(below, middle, above, LOBES, step), np.float32(threshold), table, 0
    )
    return table[:found]


def hill(x: float, y: float, layer: float) -> Array:
    """A quadratic of 100 at its top, with all its mixed terms."""
    ds, dy, dx = np.mgrid[-1:2, :SIZE, :SIZE] - np.array([layer, y, x])[:, None, None, None]
    squares = 2.0 * dx**2 + 3.0 * dy**2 + 4.0 * ds**2
    layers: Array = 100.0 - squares - 0.5 * dx * dy - 0.3 * dx * ds + 0.7 * dy * ds
    return layers


@FIRST_CALL_COMPILES
@given(OFFSET, OFFSET, OFFSET)
def test_the_maximum_of_a_quadratic_is_interpolated(dx: float, dy: float, ds: float) -> None:
    found = maxima(hill(20 + dx, 18 + dy, ds), 50.0)
    assert len(found) == 1
    assert found[0, :3] == pytest.approx([20 + dx, 18 + dy, 0.4 * (5 + 2 * ds)], abs=1e-3)


def test_positions_on_a_coarser_grid_are_those_of_the_full_image() -> None:
    x, y = maxima(hill(20.25, 18.5, 0.0), 50.0, step=4)[0, :2]
    assert (x, y) == pytest.approx((81.0, 74.0), abs=1e-3)


def test_the_response_is_that_of_the_highest_sample() -> None:
    layers = hill(20.25, 18.0, 0.1)
    assert maxima(layers, 50.0)[0, RESPONSE] == np.float32(layers.max())


def test_only_maxima_above_the_threshold_are_found() -> None:
    top = np.float32(hill(20.2, 18.1, 0.1).max())
    assert len(maxima(hill(20.2, 18.1, 0.1), float(np.nextafter(top, np.float32(0))))) == 1
    assert len(maxima(hill(20.2, 18.1, 0.1), float(top))) == 0


def brute_force(layers: Array, threshold: float) -> list[list[float]]:
    """Every sample above all 26 others whose quadratic has its top no further than a sample."""
    found = []
    for r in range(FIRST, layers.shape[1] - FIRST):
        for c in range(FIRST, layers.shape[2] - FIRST):
            cube = layers[:, r - 1 : r + 2, c - 1 : c + 2]
            v = cube[1, 1, 1]
            if v <= threshold or np.count_nonzero(cube >= v) > 1:
                continue
            ds, dy, dx = np.linalg.solve(*quadratic(cube))
            if max(abs(dx), abs(dy), abs(ds)) <= 1.0:
                found.append([c + dx, r + dy, 0.4 * (5 + 2 * ds), v])
    return found


def quadratic(cube: Array) -> tuple[Array, Array]:
    """Hessian and negative gradient at the middle of 3x3x3 values, by central differences."""
    H, g = np.empty((3, 3)), np.empty(3)
    unit = np.eye(3, dtype=int)
    for i, a in enumerate(unit):
        g[i] = (cube[tuple(1 + a)] - cube[tuple(1 - a)]) / 2
        H[i, i] = cube[tuple(1 + a)] - 2 * cube[1, 1, 1] + cube[tuple(1 - a)]
        for j, b in enumerate(unit[:i]):
            along = cube[tuple(1 + a + b)] + cube[tuple(1 - a - b)]
            H[i, j] = H[j, i] = (along - cube[tuple(1 + a - b)] - cube[tuple(1 - a + b)]) / 4
    return H, -g


@settings(FIRST_CALL_COMPILES, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(33, 47), st.integers(33, 47))
def test_the_maxima_of_noise_are_those_of_a_brute_force_search(
    seed: int, height: int, width: int
) -> None:
    layers = np.random.default_rng(seed).random((3, height, width), dtype=np.float32)
    expected = np.reshape(brute_force(layers.astype(np.float64), 0.7), (-1, 4))
    found = maxima(layers.astype(np.float64), 0.7)
    assert found.shape[0] == len(expected)
    assert found[:, :SIGN] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(
    "cells", [[(1, 0, 1)], [(1, 1, 0)], [(1, 1, 1)], [(1, 1, -1)], [(2, 0, 0)]]
)
def test_of_two_equal_neighbors_one_is_the_maximum(cells: list[tuple[int, int, int]]) -> None:
    layers = hill(20.0, 18.0, 0.0) - 20.0
    layers[1, 18, 20] = 99.0
    for layer, row, column in cells:
        layers[layer, 18 + row, 20 + column] = 99.0
    assert len(maxima(layers, 50.0)) == 1


def test_of_two_equal_layers_the_lower_one_has_the_maximum() -> None:
    layers = hill(20.0, 18.0, 0.0) - 20.0
    layers[1, 18, 20] = layers[0, 17, 21] = 99.0
    assert len(maxima(layers, 50.0)) == 0


def test_no_maximum_where_the_filter_of_the_next_layer_does_not_fit() -> None:
    assert len(maxima(hill(FIRST, 18.0, 0.0), 50.0)) == 1
    assert len(maxima(hill(FIRST - 1, 18.0, 0.0), 50.0)) == 0
    assert len(maxima(hill(20.0, SIZE - 1 - FIRST, 0.0), 50.0)) == 1
    assert len(maxima(hill(20.0, SIZE - FIRST, 0.0), 50.0)) == 0


@FIRST_CALL_COMPILES
@given(st.integers(1, 21), st.integers(1, 21))
def test_layers_too_small_for_a_maximum_have_none(height: int, width: int) -> None:
    assert len(maxima(np.random.default_rng(0).random((3, height, width)), 0.0)) == 0


def test_the_table_has_room_for_a_maximum_in_every_2x2_square() -> None:
    layers = np.zeros((3, 61, 63))
    layers[1, FIRST:-FIRST:2, FIRST:-FIRST:2] = 1.0
    found = maxima(layers, 0.5)
    assert len(found) == 20 * 21
    assert max_num_maxima(61, 63) >= len(found)


@pytest.mark.parametrize(("dark", "sign"), [(True, 1.0), (False, -1.0)])
def test_the_sign_distinguishes_dark_from_bright_blobs(dark: bool, sign: float) -> None:
    image = make_blob_image(SIZE, SIZE, (20.0, 18.0), 3.0, dark)
    table = np.empty((max_num_maxima(SIZE, SIZE), NUM_COLUMNS), np.float32)
    below, middle, above = hill(20.0, 18.0, 0.0).astype(np.float32)
    integral = cv2.integral(image)
    layers = LayerTriple(below, middle, above, LOBES, 1)
    find_maxima(integral, layers, np.float32(50), table, 0)  # type: ignore[arg-type]
    assert table[0, SIGN] == sign
    assert table[0, SCALE] == pytest.approx(2.0)
