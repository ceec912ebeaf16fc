from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.core.geometry import Array
from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES, make_textured_image
from vo_service.odometry.features.descriptor import (
    GRID_SIDE,
    SUMS_SIZE,
    disc_weights,
    dominant_direction,
)
from vo_service.odometry.features.extractor import Features, SurfExtractor

ANGLE_DEG = st.floats(0.0, 360.0)
HEIGHT, WIDTH = 400, 480
MIDDLE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])


def direction_deg(gray: Array) -> float:
    weights = disc_weights()
    dxs, dys = np.empty_like(weights), np.empty_like(weights)
    bins = np.empty(len(weights), np.int32)
    sum_x, sum_y = np.empty(SUMS_SIZE, np.float32), np.empty(SUMS_SIZE, np.float32)
    samples, inside = gray.astype(np.float32).ravel(), np.flatnonzero(weights)
    c, s = dominant_direction(samples, weights, inside, dxs, dys, bins, sum_x, sum_y)
    return float(np.degrees(np.arctan2(s, c)))


def turn_deg(a: Array | float, b: Array | float) -> Array:
    """Size of the turn from a to b, 0 to 180."""
    return np.abs((np.asarray(a) - b + 180.0) % 360.0 - 180.0)


def slope(angle_deg: float, steepness: float) -> Array:
    """Gray values that rise in a direction, about the middle of the keypoint's square."""
    y, x = np.mgrid[:GRID_SIDE, :GRID_SIDE] - GRID_SIDE // 2
    angle_rad = np.radians(angle_deg)
    gray: Array = steepness * (np.cos(angle_rad) * x + np.sin(angle_rad) * y)
    return gray


@pytest.mark.slow
@FIRST_CALL_COMPILES
@given(ANGLE_DEG, st.floats(0.5, 15.0))
def test_a_gradient_has_its_direction(angle_deg: float, steepness: float) -> None:
    assert turn_deg(direction_deg(128 + slope(angle_deg, steepness)), angle_deg) < 0.1


@FIRST_CALL_COMPILES
@given(ANGLE_DEG, st.integers(0, 1000))
def test_noise_hardly_changes_the_direction_of_a_gradient(angle_deg: float, seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (GRID_SIDE, GRID_SIDE))
    assert turn_deg(direction_deg(128 + slope(angle_deg, 8.0) + noise), angle_deg) < 3.0


@FIRST_CALL_COMPILES
@given(ANGLE_DEG, st.floats(80.0, 180.0))
def test_of_two_gradients_the_steeper_one_decides(angle_deg: float, turn: float) -> None:
    # The valley between the halves runs through the middle: each half has its own slope, and a
    # window of 60 degrees never holds both.
    y, x = np.mgrid[:GRID_SIDE, :GRID_SIDE] - GRID_SIDE // 2
    steep, gentle = slope(angle_deg, 9.0), slope(angle_deg + turn, 4.0)
    along = np.cos(np.radians(angle_deg)) * x + np.sin(np.radians(angle_deg)) * y
    gray = np.where(along >= 0, steep, gentle)
    assert turn_deg(direction_deg(128 + gray), angle_deg) < 20.0


def test_a_constant_image_has_the_direction_of_the_image() -> None:
    assert direction_deg(np.full((GRID_SIDE, GRID_SIDE), 77.0)) == 0.0


@dataclass(frozen=True)
class Repeated:
    """Keypoints of an image that are found again in the turned image: i in one, j in the other."""

    before: Features
    after: Features
    i: NDArray[np.intp]
    j: NDArray[np.intp]
    distance_px: Array


def turned_by(angle_deg: float, upright: bool = False) -> Repeated:
    """Features before and after the image is turned, x towards y, about its middle."""
    image = make_textured_image(HEIGHT, WIDTH, 3)
    A = cv2.getRotationMatrix2D((float(MIDDLE[0]), float(MIDDLE[1])), -angle_deg, 1.0)
    turned = cv2.warpAffine(image, A, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    before = SurfExtractor(600, upright).extract(image)
    after = SurfExtractor(600, upright).extract(turned)  # type: ignore[arg-type]
    expected_px = before.position_px @ A[:, :2].T + A[:, 2]
    distance_px = np.linalg.norm(expected_px[:, None] - after.position_px, axis=2)
    j = distance_px.argmin(axis=1)
    same_scale = np.abs(np.log(before.scale_px / after.scale_px[j])) < np.log(1.2)
    stays_inside = np.linalg.norm(before.position_px - MIDDLE, axis=1) < 150.0
    i = np.flatnonzero((distance_px.min(axis=1) < 1.5) & same_scale & stays_inside)
    return Repeated(before, after, i, j[i], distance_px)


def degrees(features: Features) -> Array:
    angles: Array = np.degrees(np.arctan2(features.direction[:, 1], features.direction[:, 0]))
    return angles


def share_matched(repeated: Repeated) -> float:
    """Share of the repeated keypoints whose nearest descriptor is that of the same place."""
    ours = repeated.before.descriptor[repeated.i]
    nearest = np.linalg.norm(ours[:, None] - repeated.after.descriptor, axis=2).argmin(axis=1)
    return float(np.mean(repeated.distance_px[repeated.i, nearest] < 1.5))


@pytest.mark.parametrize("angle_deg", [30.0, 45.0, 90.0, 137.0, 180.0, 270.0])
def test_directions_and_descriptors_rotate_with_the_image(angle_deg: float) -> None:
    repeated = turned_by(angle_deg)
    assert len(repeated.i) > 100
    turns = degrees(repeated.after)[repeated.j] - degrees(repeated.before)[repeated.i]
    errors_deg = turn_deg(turns, angle_deg)
    assert np.median(errors_deg) < 5.0
    assert np.mean(errors_deg < 15.0) > 0.7
    assert share_matched(repeated) > 0.75


def test_upright_features_have_the_direction_of_the_image_and_do_not_match_after_a_rotation() -> (
    None
):
    repeated = turned_by(45.0, upright=True)
    assert np.all(repeated.after.direction == [1.0, 0.0])
    assert share_matched(repeated) < 0.2
