import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.core.geometry import Array
from tests.vo_service.odometry.features.response_layers import response_layer
from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES
from vo_service.odometry.features.detector import (
    NUM_COLUMNS,
    RESPONSE,
    SIGN,
    Layer,
    find_maxima,
    interpolate,
    is_first_of_equals,
)

LOBES = (3, 5, 7)
FINE, COARSE = Layer(LOBES, 1), Layer((9, 17, 25), 4)
FIRST = {1: 11, 4: 11}  # samples: half of the filter above, and one neighbor
OFFSET = st.floats(-0.4, 0.4)  # further out, the mixed terms can lift a neighbor above


def maxima(
    image: NDArray[np.uint8], layer: Layer = FINE, threshold: float = 10.0
) -> NDArray[np.float32]:
    """Keypoints of one layer."""
    integral: NDArray[np.int32] = cv2.integral(image)  # type: ignore[assignment]
    return find_maxima(integral, layer, np.float32(threshold))


def noise(height: int, width: int, seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


def hill(x: float, y: float, layer: float) -> NDArray[np.float32]:
    """3x3x3 values of a quadratic of 100 at its top, with all its mixed terms."""
    ds, dy, dx = np.mgrid[-1:2, -1:2, -1:2] - np.array([layer, y, x])[:, None, None, None]
    squares = 2.0 * dx**2 + 3.0 * dy**2 + 4.0 * ds**2
    values: Array = 100.0 - squares - 0.5 * dx * dy - 0.3 * dx * ds + 0.7 * dy * ds
    return values.astype(np.float32)


@FIRST_CALL_COMPILES
@given(OFFSET, OFFSET, OFFSET)
def test_the_maximum_of_a_quadratic_is_interpolated(dx: float, dy: float, ds: float) -> None:
    entry = np.empty(NUM_COLUMNS, np.float32)
    cube = hill(dx, dy, ds)
    assert interpolate(cube, FINE, 18, 20, entry)
    assert entry[:3] == pytest.approx([20 + dx, 18 + dy, 0.4 * (5 + 2 * ds)], abs=1e-3)
    assert entry[RESPONSE] == cube[1, 1, 1]


def test_positions_on_a_coarser_grid_are_those_of_the_full_image() -> None:
    entry = np.empty(NUM_COLUMNS, np.float32)
    assert interpolate(hill(0.25, 0.5, 0.0), COARSE, 72, 80, entry)
    assert entry[:3] == pytest.approx([81.0, 74.0, 0.4 * 17], abs=1e-3)


def test_a_top_more_than_a_sample_away_is_no_blob() -> None:
    entry = np.empty(NUM_COLUMNS, np.float32)
    assert interpolate(hill(0.95, 0.0, 0.0), FINE, 18, 20, entry)
    assert not interpolate(hill(1.05, 0.0, 0.0), FINE, 18, 20, entry)


@pytest.mark.parametrize("neighbor", list(np.ndindex(3, 3, 3)))
def test_of_two_equal_neighbors_the_first_is_the_maximum(neighbor: tuple[int, int, int]) -> None:
    cube = hill(0.0, 0.0, 0.0)
    cube[neighbor] = cube[1, 1, 1]
    # In order of layer, row, column; of the layer below, all are first.
    assert is_first_of_equals(cube) == (neighbor >= (1, 1, 1))


def test_only_maxima_above_the_threshold_are_found() -> None:
    image = noise(60, 70, 1)
    top = maxima(image)[:, RESPONSE].max()
    assert len(maxima(image, threshold=float(np.nextafter(top, np.float32(0))))) == 1
    assert len(maxima(image, threshold=float(top))) == 0


def brute_force(image: NDArray[np.uint8], layer: Layer, threshold: float) -> list[list[float]]:
    """Every sample above all 26 others whose quadratic has its top no further than a sample."""
    lobes, step = layer
    layers = np.stack([response_layer(image, lobe, step) for lobe in lobes]).astype(np.float64)
    found = []
    for r in range(FIRST[step], layers.shape[1] - FIRST[step]):
        for c in range(FIRST[step], layers.shape[2] - FIRST[step]):
            cube = layers[:, r - 1 : r + 2, c - 1 : c + 2]
            v = cube[1, 1, 1]
            if v <= threshold or np.count_nonzero(cube >= v) > 1:
                continue
            ds, dy, dx = np.linalg.solve(*quadratic(cube))
            if max(abs(dx), abs(dy), abs(ds)) <= 1.0:
                scale = 0.4 * (lobes[1] + ds * (lobes[2] - lobes[1]))
                found.append([(c + dx) * step, (r + dy) * step, scale, v])
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
@given(st.integers(0, 2**32 - 1), st.integers(33, 61), st.integers(33, 61))
def test_the_maxima_of_noise_are_those_of_a_brute_force_search(
    seed: int, height: int, width: int
) -> None:
    image = noise(height, width, seed)
    expected = np.reshape(brute_force(image, FINE, 10.0), (-1, 4))
    found = maxima(image)
    assert found.shape[0] == len(expected)
    assert found[:, :SIGN] == pytest.approx(expected, rel=1e-4, abs=2e-3)


@pytest.mark.parametrize("shape", [(240, 320), (233, 307), (230, 294)])
def test_coarse_maxima_are_those_of_a_brute_force_search(shape: tuple[int, int]) -> None:
    smooth = cv2.GaussianBlur(noise(*shape, 3), (0, 0), 3.0).astype(float)
    bright = ((smooth - smooth.min()) * (255 / np.ptp(smooth))).astype(np.uint8)
    expected = np.reshape(brute_force(bright, COARSE, 10.0), (-1, 4))
    found = maxima(bright, COARSE)
    assert len(expected) > 5
    assert found.shape[0] == len(expected)
    assert found[:, :SIGN] == pytest.approx(expected, rel=1e-4, abs=2e-3)


@FIRST_CALL_COMPILES
@given(st.integers(1, 22), st.integers(1, 60), st.booleans())
def test_images_too_small_for_a_maximum_have_none(small: int, other: int, wide: bool) -> None:
    shape = (small, other) if wide else (other, small)
    assert len(maxima(noise(*shape, 0), threshold=0.0)) == 0


def test_maxima_may_lie_next_to_the_margin() -> None:
    found = np.rint(maxima(noise(40, 2000, 5))[:, 1])
    assert (found.min(), found.max()) == (FIRST[1], 40 - 1 - FIRST[1])


@pytest.mark.parametrize("spacing", [3, 7])
def test_no_maximum_of_a_raster_is_left_out(spacing: int) -> None:
    image = np.full((100, 120), 60, np.uint8) + noise(100, 120, 2) // np.uint8(16)
    image[::spacing, ::spacing] = 230
    expected = np.reshape(brute_force(image, FINE, 10.0), (-1, 4))
    found = maxima(image)
    assert len(expected) > 100
    assert found[:, :SIGN] == pytest.approx(expected, rel=1e-4, abs=2e-3)
