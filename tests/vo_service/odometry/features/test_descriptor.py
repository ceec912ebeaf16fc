import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from drivers.core.geometry import Array
from tests.vo_service.odometry.synthetic_views import make_blob_image, make_textured_image
from vo_service.odometry.features.descriptor import DESCRIPTOR_NORM, DESCRIPTOR_SIZE, build_pyramid
from vo_service.odometry.features.extractor import Features, SurfExtractor


def gray_patch(image: NDArray[np.uint8], features: Features, n: int) -> Array:
    """21x21 gray values in the keypoint's own axes, sampled at 0.9 to 1.8 pixels."""
    scale = features.scale_px[n]
    level = min(3, max(0, int(np.ceil(np.log2(scale / 1.8)))))
    pyramid = build_pyramid(image)
    offset, height, width = pyramid.level_table[level]
    packed = pyramid.packed[offset : offset + height * width]
    gray = (packed & 255).astype(float).reshape(height, width)
    zoom = np.array([width / image.shape[1], height / image.shape[0]])
    x, y = (features.position_px[n] + 0.5) * zoom - 0.5
    down, along = np.mgrid[-10:11, -10:11] * float(scale * zoom[0])
    c, s = features.direction[n]
    at = [y + s * along + c * down, x + c * along - s * down]
    patch: Array = map_coordinates(gray, at, order=1, mode="nearest", prefilter=False)
    return patch


def expected_descriptor(patch: Array) -> Array:
    """Sums over 4x4 regions of 5x5 Haar responses, as the paper's Section 4.2 words it."""
    dx = patch[:-1, 1:] + patch[1:, 1:] - patch[:-1, :-1] - patch[1:, :-1]
    dy = patch[1:, :-1] + patch[1:, 1:] - patch[:-1, :-1] - patch[:-1, 1:]
    y, x = np.mgrid[:20, :20] - 9.5
    weight = np.exp(-(x**2 + y**2) / (2 * 4.5**2))
    sums = []
    for row in range(0, 20, 5):
        for column in range(0, 20, 5):
            region = slice(row, row + 5), slice(column, column + 5)
            u, v = (weight * dx)[region], (weight * dy)[region]
            sums += [u.sum(), v.sum(), np.abs(u).sum(), np.abs(v).sum()]
    values = np.array(sums)
    length = np.sqrt(np.abs(values).sum())
    expected: Array = 300.0 * np.sign(values) * np.sqrt(np.abs(values)) / length
    return expected


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("shape", [(240, 320), (233, 307)])
def test_descriptors_are_those_of_a_reference_implementation(
    upright: bool, shape: tuple[int, int]
) -> None:
    image = make_textured_image(*shape, seed=5)
    features = SurfExtractor(400, upright).extract(image)
    largest = int(features.scale_px.argmax())
    for n in (0, 1, 50, 100, 200, len(features) - 1, largest):
        expected = expected_descriptor(gray_patch(image, features, n))
        assert features.descriptor[n] == pytest.approx(expected, abs=1.0)
        assert np.mean(np.abs(features.descriptor[n] - expected)) < 0.35  # rounding alone: 0.25


def test_keypoints_near_the_edge_of_a_rotated_image_are_described() -> None:
    # The window of a keypoint near the border reaches outside: the border's pixels are repeated.
    image = make_blob_image(60, 60, (20.0, 18.0), 4.0)
    features = SurfExtractor().extract(image)
    assert np.any(features.position_px.min(axis=1) < 10 * features.scale_px)
    assert np.all(np.isfinite(features.descriptor))


def test_descriptors_are_integers_of_one_length() -> None:
    descriptor = SurfExtractor().extract(make_textured_image(240, 320)).descriptor
    assert descriptor.shape[1] == DESCRIPTOR_SIZE
    assert np.array_equal(descriptor, np.rint(descriptor))
    assert np.linalg.norm(descriptor, axis=1) == pytest.approx(DESCRIPTOR_NORM, rel=0.01)


def test_brightness_changes_nothing() -> None:
    image = make_textured_image(240, 320) // 2 + np.uint8(20)
    dark, bright = SurfExtractor().extract(image), SurfExtractor().extract(image + np.uint8(60))
    assert np.array_equal(dark.position_px, bright.position_px)
    assert np.abs(dark.descriptor - bright.descriptor).max() <= 1.0


def test_contrast_changes_hardly_anything() -> None:
    image = make_textured_image(240, 320) // 2 + np.uint8(20)
    stronger = (image * 1.5).astype(np.uint8)
    weak, strong = SurfExtractor(200).extract(image), SurfExtractor(200).extract(stronger)
    distance_px = np.linalg.norm(weak.position_px[:, None] - strong.position_px, axis=2)
    i = np.flatnonzero(distance_px.min(axis=1) < 0.3)
    assert len(i) > 150
    products = weak.descriptor[i] * strong.descriptor[distance_px.argmin(axis=1)[i]]
    assert np.median(products.sum(axis=1)) / DESCRIPTOR_NORM**2 > 0.99
