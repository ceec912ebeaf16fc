from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.vo_service.odometry.features.box_filters import cross_filter, vertical_filter
from tests.vo_service.odometry.synthetic_views import make_blob_image, make_textured_image
from vo_service.odometry.features.detector import RESPONSE, SCALE, SIGN
from vo_service.odometry.features.extractor import Features, SurfExtractor, detect_keypoints

SHAPE = (240, 320)

FIELDS = ("position_px", "scale_px", "direction", "response", "sign", "descriptor")


def noise(height: int, width: int, low: int = 0, high: int = 256) -> NDArray[np.uint8]:
    return np.random.default_rng(7).integers(low, high, (height, width), dtype=np.uint8)


def raster(height: int, width: int) -> NDArray[np.uint8]:
    """Dots at every fifth pixel under faint noise: as many strong maxima as there can be."""
    image = np.full((height, width), 60, np.uint8)
    image[::5, ::5] = 230
    return image + noise(height, width, 0, 17)


def bits(features: Features) -> bytes:
    return b"".join(getattr(features, field).tobytes() for field in FIELDS)


@pytest.mark.parametrize("image", [make_textured_image(*SHAPE), raster(960, 1280), noise(480, 640)])
@pytest.mark.parametrize("contrast", [1, 16, 60, 256])
def test_features_do_not_depend_on_the_image_before(
    image: NDArray[np.uint8], contrast: int
) -> None:
    height, width = image.shape
    used = SurfExtractor()
    used.extract(noise(height, width, 0, contrast))
    assert bits(used.extract(image)) == bits(SurfExtractor().extract(image))


def test_the_size_of_the_image_may_change() -> None:
    extractor = SurfExtractor()
    images = [make_textured_image(*shape) for shape in (SHAPE, (120, 160), (241, 317), SHAPE)]
    expected = [bits(SurfExtractor().extract(image)) for image in images]
    assert [bits(extractor.extract(image)) for image in images] == expected


def test_released_buffers_take_no_memory_and_are_made_again() -> None:
    extractor, image = SurfExtractor(), make_textured_image(*SHAPE)
    first = bits(extractor.extract(image))
    assert extractor.kept_bytes > 3 * image.size
    extractor.release_buffers()
    assert extractor.kept_bytes == 0
    assert bits(extractor.extract(image)) == first


def test_the_next_image_does_not_overwrite_returned_features() -> None:
    extractor = SurfExtractor()
    first = extractor.extract(make_textured_image(*SHAPE))
    before = bits(first)
    extractor.extract(make_textured_image(*SHAPE, seed=1))
    assert bits(first) == before


def test_the_strongest_are_kept_strongest_first() -> None:
    image = make_textured_image(*SHAPE)
    all_of_them = SurfExtractor(100_000).extract(image)
    fifty = SurfExtractor(50).extract(image)
    assert len(all_of_them) > 200
    assert np.all(np.diff(all_of_them.response) <= 0)
    assert np.array_equal(fifty.position_px, all_of_them.position_px[:50])
    assert np.array_equal(fifty.descriptor, all_of_them.descriptor[:50])


def test_all_fields_are_float32_and_of_one_length() -> None:
    features = SurfExtractor(123).extract(make_textured_image(*SHAPE))
    assert len(features) == 123
    assert all(len(getattr(features, field)) == 123 for field in FIELDS)
    assert all(getattr(features, field).dtype == np.float32 for field in FIELDS)
    assert np.linalg.norm(features.direction, axis=1) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("shape", [(16, 16), (20, 33), (17, 640), SHAPE])
@pytest.mark.parametrize("gray", [0, 128, 255])
def test_a_blank_image_has_no_features(shape: tuple[int, int], gray: int) -> None:
    features = SurfExtractor().extract(np.full(shape, gray, np.uint8))
    assert len(features) == 0
    assert features.descriptor.shape == (0, 64)


@pytest.mark.parametrize("shape", [(16, 16), (20, 33), (17, 640), (33, 32), (101, 57)])
def test_noise_of_any_size_is_described(shape: tuple[int, int]) -> None:
    features = SurfExtractor().extract(noise(*shape))
    assert np.all(np.isfinite(features.descriptor))
    assert np.all((features.position_px >= 0) & (features.position_px < shape[::-1]))


def test_sensor_noise_alone_gives_no_feature() -> None:
    gray = np.random.default_rng(1).normal(128.0, 0.8, SHAPE)
    assert len(SurfExtractor().extract(np.rint(gray).astype(np.uint8))) == 0


def test_a_non_contiguous_image_gives_the_same_features() -> None:
    image = make_textured_image(*SHAPE)
    wide = np.zeros((SHAPE[0], 2 * SHAPE[1]), np.uint8)
    wide[:, ::2] = image
    assert bits(SurfExtractor().extract(wide[:, ::2])) == bits(SurfExtractor().extract(image))


def test_two_extractors_at_once_do_not_disturb_each_other() -> None:
    images = [make_textured_image(*SHAPE, seed=seed) for seed in range(6)] + [
        make_blob_image(*SHAPE, (100.0, 90.0), 5.0)
    ]

    def extract_all() -> list[bytes]:
        extractor = SurfExtractor()
        return [bits(extractor.extract(image)) for image in images]

    with ThreadPoolExecutor(2) as pool:
        first, second = pool.submit(extract_all), pool.submit(extract_all)
        assert first.result() == second.result() == extract_all()


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
