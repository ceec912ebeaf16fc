import numpy as np
from numpy.testing import assert_allclose

from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam.place_recognition.corner_keyframes import HERE, ZERO_VELOCITY
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe_points import POINT_BRIGHTNESS, select_points
from vo_service.slam.place_recognition.map_keyframe import (
    DECIMATION_MIN_POINTS,
    MapKeyframe,
    PackedPoints,
)


def test_points_are_packed_to_a_thousandth_and_brightness_losslessly() -> None:
    images = build_image_pyramid(render_corner(HERE))
    coarse = select_points(images, ZERO_VELOCITY, ALL_STATIC)[-1]
    unpacked = PackedPoints.pack(coarse).unpack()
    assert 0 < len(coarse) <= DECIMATION_MIN_POINTS
    assert_allclose(unpacked, coarse, rtol=1e-3, atol=1e-6)
    assert np.array_equal(unpacked[:, POINT_BRIGHTNESS], coarse[:, POINT_BRIGHTNESS])


def test_every_second_point_is_kept() -> None:
    points = np.random.default_rng(5).normal(size=(DECIMATION_MIN_POINTS + 1, 13))
    unpacked = PackedPoints.pack(points).unpack()
    assert_allclose(unpacked[:, :3], points[::2, :3], rtol=1e-6)


def test_gradients_beyond_half_precision_stay_finite() -> None:
    assert np.isfinite(PackedPoints.pack(np.full((3, 13), 1e6)).unpack()).all()


def test_a_keyframe_takes_less_than_150_kilobytes(here: MapKeyframe) -> None:
    assert 20_000 < here.size_bytes < 150_000
    assert here.size_bytes > sum(level.attributes.nbytes for level in here.packed_points)
