import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.vo_service.odometry.features.box_filters import cross_filter, vertical_filter
from tests.vo_service.odometry.synthetic_views import make_blob_image
from vo_service.odometry.features.detector import RESPONSE, SCALE, SIGN
from vo_service.odometry.features.extractor import detect_keypoints

SIZE = 201
CENTRES_PX = [(100.0, 100.0), (100.3, 99.6), (99.55, 100.45), (98.8, 101.1)]
SIGMAS_PX = [2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
LOBES = np.arange(3, 49, 2)


def strongest(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    found = detect_keypoints(cv2.integral(image), 10.0)  # type: ignore[arg-type]
    keypoint: NDArray[np.float32] = found[found[:, RESPONSE].argmax()]
    return keypoint


def response_at(image: NDArray[np.uint8], lobe: int, x: int, y: int) -> float:
    """det(H) of the filters written out pixel by pixel."""
    border = 3 * lobe // 2
    window = image[y - border : y + border + 1, x - border : x + border + 1].astype(np.int64)
    tall = vertical_filter(lobe)
    xx, yy = int((window * tall.T).sum()), int((window * tall).sum())
    xy = int((window * cross_filter(lobe)).sum())
    return float((xx * yy - 1.2 * xy * xy) / (lobe * (2 * lobe - 1)) ** 2)


def expected_scale(sigma_px: float) -> float:
    """Scale of the filter that responds most to a blob, of all odd filters there could be."""
    image = make_blob_image(SIZE, SIZE, (100.0, 100.0), sigma_px)
    values = [response_at(image, int(lobe), 100, 100) for lobe in LOBES]
    i = int(np.argmax(values))
    before, top, after = values[i - 1 : i + 2]
    offset = 0.5 * (before - after) / (before - 2 * top + after)
    return float(0.4 * (LOBES[i] + 2 * offset))


@pytest.mark.parametrize("sigma_px", SIGMAS_PX)
@pytest.mark.parametrize("center_px", CENTRES_PX)
def test_a_blob_is_found_at_its_center_between_the_pixels(
    sigma_px: float, center_px: tuple[float, float]
) -> None:
    found = strongest(make_blob_image(SIZE, SIZE, center_px, sigma_px))
    assert found[:2] == pytest.approx(center_px, abs=0.15)


@pytest.mark.parametrize("sigma_px", SIGMAS_PX)
def test_a_blob_is_found_at_the_scale_whose_filter_responds_most(sigma_px: float) -> None:
    found = strongest(make_blob_image(SIZE, SIZE, (100.3, 99.6), sigma_px))
    # Between layers that lie half an octave apart a parabola is good to an eighth.
    assert found[SCALE] == pytest.approx(expected_scale(sigma_px), rel=0.125)


@pytest.mark.parametrize("sigma_px", [3.0, 6.0, 10.0])
def test_dark_blobs_are_found_as_bright_ones_are(sigma_px: float) -> None:
    bright = strongest(make_blob_image(SIZE, SIZE, (100.3, 99.6), sigma_px))
    dark = strongest(make_blob_image(SIZE, SIZE, (100.3, 99.6), sigma_px, dark=True))
    assert dark[:SIGN] == pytest.approx(bright[:SIGN])
    assert (bright[SIGN], dark[SIGN]) == (-1.0, 1.0)


def test_the_response_of_a_blob_is_that_of_its_best_filter() -> None:
    image = make_blob_image(SIZE, SIZE, (100.0, 100.0), 3.0)
    layers = [response_at(image, lobe, 100, 100) for lobe in (5, 7, 9, 13)]
    assert strongest(image)[RESPONSE] == pytest.approx(max(layers), rel=1e-5)


def test_the_maxima_come_octave_by_octave_and_row_by_row() -> None:
    image = np.full((SIZE, SIZE), 40, np.uint8)
    for y, x, sigma_px in ((150, 60, 3.0), (60, 150, 3.0), (60, 60, 9.0)):
        np.maximum(image, make_blob_image(SIZE, SIZE, (x, y), sigma_px), out=image)
    found = detect_keypoints(cv2.integral(image), 5000.0)  # type: ignore[arg-type]
    assert np.rint(found[:, :2]).tolist() == [[150, 60], [60, 150], [60, 60]]
