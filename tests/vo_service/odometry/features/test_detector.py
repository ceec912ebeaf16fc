import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.core.geometry import Array
from tests.vo_service.odometry.features.box_filters import hessian_products
from tests.vo_service.odometry.features.response_layers import response_layer
from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES, make_blob_image
from vo_service.odometry.features.detector import (
    NUM_COLUMNS,
    RESPONSE,
    SCALE_PER_LOBE,
    SIGN,
    Layer,
    box_rows,
    find_maxima,
    interpolate,
    is_first_of_equals,
    is_laplacian_positive,
    lobe_margin,
    response_at,
)


def noise(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


@pytest.mark.parametrize(
    ("lobe", "height", "width"),
    [
        (3, 41, 53),
        (5, 40, 37),
        (7, 38, 41),
        (9, 61, 44),
        (13, 48, 61),
        (17, 55, 64),
        (33, 104, 117),
    ],
)
def test_responses_are_those_of_filters_summed_pixel_by_pixel(
    lobe: int, height: int, width: int
) -> None:
    image = noise(height, width)
    straight, crossed = hessian_products(image, lobe)
    error = np.abs(response_layer(image, lobe) - (straight - 1.2 * crossed))
    assert np.all(error <= 1e-6 * (np.abs(straight) + 1.2 * crossed))


@pytest.mark.parametrize("lobe", [3, 5, 9, 17, 33])
def test_the_response_of_one_pixel_is_that_of_its_row(lobe: int) -> None:
    image = noise(104, 117)
    integral: NDArray[np.int32] = cv2.integral(image)  # type: ignore[assignment]
    layer, margin = response_layer(image, lobe), lobe_margin(lobe)
    for r in range(margin, 104 - margin, 5):
        for c in range(margin, 117 - margin, 3):
            assert response_at(box_rows(integral, lobe, r), lobe, c) == layer[r, c]


@pytest.mark.parametrize("shape", [(64, 64), (61, 75), (63, 66), (120, 57)])
@pytest.mark.parametrize("lobe", [9, 17])
def test_every_fourth_response_is_the_same_as_of_all(shape: tuple[int, int], lobe: int) -> None:
    image = noise(*shape)
    assert np.array_equal(response_layer(image, lobe, 4), response_layer(image, lobe)[::4, ::4])


@pytest.mark.parametrize("lobe", [3, 5, 7])
def test_a_bowl_has_the_analytic_response(lobe: int) -> None:
    # Of x^2 the outer lobes' means are l^2 above the middle one's: Dxx = Dyy = 2 l^2.
    y, x = np.mgrid[-11:12, -11:12]
    found = response_layer((x**2 + y**2).clip(max=255).astype(np.uint8), lobe)
    assert found[11, 11] == pytest.approx(4 * lobe**4)


@pytest.mark.parametrize("lobe", [3, 5, 7])
def test_a_saddle_has_the_analytic_response(lobe: int) -> None:
    # Of x y the lobes' means are +-((l + 1) / 2)^2, four lobes of l^2 pixels.
    y, x = np.mgrid[-11:12, -11:12]
    found = response_layer((128 + x * y).astype(np.uint8), lobe)
    cross = lobe * (lobe + 1) ** 2 / (2 * lobe - 1)
    assert found[11, 11] == pytest.approx(-1.2 * cross**2)


def test_a_gradient_has_no_response() -> None:
    y, x = np.mgrid[:60, :70]
    assert np.all(response_layer((10 + x + 2 * y).astype(np.uint8), 9) == 0)


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("lobe", [5, 9, 17])
def test_the_laplacian_is_positive_on_dark_blobs_only(dark: bool, lobe: int) -> None:
    image = make_blob_image(90, 80, (40.0, 45.0), SCALE_PER_LOBE * lobe, dark)
    integral: NDArray[np.int32] = cv2.integral(image)  # type: ignore[assignment]
    assert is_laplacian_positive(box_rows(integral, lobe, 45), lobe, 40) is dark


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
