import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.vo_service.odometry.features.box_filters import hessian_products
from tests.vo_service.odometry.features.response_layers import response_layer
from tests.vo_service.odometry.synthetic_views import make_blob_image
from vo_service.odometry.features.detector import (
    SCALE_PER_LOBE,
    box_rows,
    is_laplacian_positive,
    lobe_margin,
    response_at,
)


def noise(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(height).integers(0, 256, (height, width), dtype=np.uint8)


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
