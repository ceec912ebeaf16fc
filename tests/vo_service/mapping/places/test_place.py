import numpy as np
from numpy.testing import assert_allclose

from tests.vo_service.mapping.places.corner_places import HERE, STANDING
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.mapping.places.place import MANY_POINTS, PackedPoints, Place
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.points import BRIGHTNESS, find_points


def test_points_are_packed_to_a_thousandth_and_brightness_exactly() -> None:
    images = make_images(view_of_a_corner(HERE))
    coarse = find_points(images, STANDING, ALL_STILL)[-1]
    unpacked = PackedPoints.of(coarse).unpacked()
    assert 0 < len(coarse) <= MANY_POINTS
    assert_allclose(unpacked, coarse, rtol=1e-3, atol=1e-6)
    assert np.array_equal(unpacked[:, BRIGHTNESS], coarse[:, BRIGHTNESS])


def test_of_many_points_every_second_one_is_kept() -> None:
    points = np.random.default_rng(5).normal(size=(MANY_POINTS + 1, 13))
    unpacked = PackedPoints.of(points).unpacked()
    assert_allclose(unpacked[:, :3], points[::2, :3], rtol=1e-6)


def test_slopes_beyond_half_precision_stay_finite() -> None:
    assert np.isfinite(PackedPoints.of(np.full((3, 13), 1e6)).unpacked()).all()


def test_a_place_takes_less_than_150_kilobytes(here: Place) -> None:
    assert 20_000 < here.bytes < 150_000
    assert here.bytes > sum(level.rest.nbytes for level in here.packed_points)
