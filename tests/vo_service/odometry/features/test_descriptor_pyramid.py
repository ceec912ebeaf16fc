import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES, make_textured_image
from vo_service.odometry.features.descriptor import (
    NUM_LEVELS,
    PackedLevel,
    build_pyramid,
    centered_grid,
    level_for_scale,
    rotate_grid,
    sample_bilinear,
)


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
