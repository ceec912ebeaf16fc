import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from drivers.core.geometry import Array
from tests.vo_service.odometry.synthetic_views import (
    FIRST_CALL_COMPILES,
    make_blob_image,
    make_textured_image,
)
from vo_service.odometry.features.descriptor import (
    DESCRIPTOR_NORM,
    DESCRIPTOR_SIZE,
    NUM_LEVELS,
    PackedLevel,
    build_pyramid,
    centered_grid,
    level_for_scale,
    rotate_grid,
    sample_bilinear,
)
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


def unpacked(image: NDArray[np.uint8], level: int) -> NDArray[np.uint8]:
    pyramid = build_pyramid(image)
    offset, height, width = pyramid.level_table[level]
    packed = pyramid.packed[offset : offset + height * width]
    return (packed & 255).astype(np.uint8).reshape(height, width)


def test_the_full_size_is_smoothed_by_a_gaussian_of_0_7_pixels() -> None:
    image = make_textured_image(40, 50)
    side, middle = np.exp(-0.5 / 0.49), 1.0
    weights = np.array([side, middle, side]) / (2 * side + middle)
    rows = np.pad(image.astype(float), 1, mode="reflect")
    rows = weights[0] * rows[:-2] + weights[1] * rows[1:-1] + weights[2] * rows[2:]
    smooth = weights[0] * rows[:, :-2] + weights[1] * rows[:, 1:-1] + weights[2] * rows[:, 2:]
    assert np.abs(unpacked(image, 0) - smooth).max() <= 1.0


def test_each_level_is_the_mean_of_four_pixels_of_the_one_before() -> None:
    image = make_textured_image(48, 64)
    for level in range(1, NUM_LEVELS):
        finer = unpacked(image, level - 1).astype(float)
        means = (finer[::2, ::2] + finer[1::2, ::2] + finer[::2, 1::2] + finer[1::2, 1::2]) / 4
        assert np.abs(unpacked(image, level) - means).max() <= 0.5


@pytest.mark.parametrize("shape", [(16, 16), (20, 33), (61, 75), (17, 640)])
def test_odd_sizes_are_halved_downwards(shape: tuple[int, int]) -> None:
    sizes = build_pyramid(np.zeros(shape, np.uint8)).level_table[:, 1:]
    assert sizes.tolist() == [[shape[0] >> k, shape[1] >> k] for k in range(NUM_LEVELS)]


@pytest.mark.slow
@FIRST_CALL_COMPILES
@given(st.lists(st.tuples(st.floats(-30, 130), st.floats(-30, 130)), min_size=1, max_size=50))
def test_samples_are_bilinear_and_clamped_to_the_image(points: list[tuple[float, float]]) -> None:
    image = make_textured_image(90, 100)
    pyramid = build_pyramid(image)
    offset, height, width = pyramid.level_table[1]
    x, y = np.array(points, np.float32).T.copy()
    expected = map_coordinates(
        unpacked(image, 1).astype(float), [y, x], order=1, mode="nearest", prefilter=False
    )
    where, squares = np.empty(len(x), np.int32), np.empty(len(x), np.uint32)
    out = np.empty(len(x), np.float32)
    level = PackedLevel(pyramid.packed, offset, height, width)
    sample_bilinear(level, x, y, where, squares, out)
    assert out == pytest.approx(expected, abs=0.01)


@FIRST_CALL_COMPILES
@given(st.floats(1.0, 13.4))
def test_a_keypoint_is_sampled_where_its_spacing_is_about_a_pixel(scale: float) -> None:
    level = level_for_scale(np.float32(scale))
    assert 0.9 <= scale / 2**level <= 1.8001


def test_a_rotated_grid_rotates_from_x_towards_y() -> None:
    us, vs = np.empty(9, np.float32), np.empty(9, np.float32)
    angle_rad = np.radians(30.0)
    rotate_grid(
        np.float32(5), np.float32(7), np.float32(2 * np.cos(angle_rad)),
        np.float32(2 * np.sin(angle_rad)), centered_grid(3), us, vs,
    )  # fmt: skip
    corners = cv2.transform(
        2 * centered_grid(3).T.reshape(-1, 1, 2),
        np.array([[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]]),
    ).reshape(-1, 2)
    assert np.stack([us - 5, vs - 7], axis=1) == pytest.approx(corners, abs=1e-5)
