"""Keyframes of the map: their descriptors, their points and their database."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drivers.core.geometry import Array
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam.corner_keyframes import (
    BESIDE,
    HERE,
    ZERO_VELOCITY,
    make_pose,
    make_query,
)
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.points import Points, select_points
from vo_service.slam.keyframe_database import (
    DECIMATION_MIN_POINTS,
    DESCRIPTOR_NORM,
    KeyframeDatabase,
    MapKeyframe,
    PackedPoints,
    VladVocabulary,
)
from vo_service.slam.place_recognizer import PlaceRecognizer


@pytest.fixture(scope="module")
def vocabulary() -> VladVocabulary:
    return VladVocabulary.default()


def test_the_shipped_vocabulary_has_distinct_integers(vocabulary: VladVocabulary) -> None:
    assert vocabulary.cluster_centers.shape[1] == 64
    assert (
        len(np.unique(vocabulary.cluster_centers, axis=0)) == len(vocabulary.cluster_centers) >= 32
    )
    assert np.array_equal(vocabulary.cluster_centers, np.rint(vocabulary.cluster_centers))


def test_a_descriptor_has_its_length_whatever_the_number_of_features(
    vocabulary: VladVocabulary,
) -> None:
    random = np.random.default_rng(0)
    for count in (5, 50, 500):
        descriptor = vocabulary.describe(random.integers(-80, 80, (count, 64)))
        assert np.linalg.norm(descriptor.astype(float)) == pytest.approx(DESCRIPTOR_NORM, rel=0.05)


def test_no_features_give_an_empty_descriptor(vocabulary: VladVocabulary) -> None:
    assert not vocabulary.describe(np.empty((0, 64), np.int8)).any()


def make_points(vectors: Array) -> Points:
    """Points with these positions and gradients (3, N)."""
    is_used = np.ones(vectors.shape[1], np.bool_)
    return Points(vectors, vectors[0], vectors[1], vectors, vectors, is_used, is_used)


def test_points_are_packed_to_a_thousandth_and_brightness_losslessly() -> None:
    images = build_image_pyramid(render_corner(HERE))
    coarse = select_points(images, ZERO_VELOCITY, ALL_STATIC)[-1]
    unpacked = PackedPoints.pack(coarse).unpack()
    assert 0 < len(coarse.brightness) <= DECIMATION_MIN_POINTS
    for field, exact in zip(unpacked, coarse, strict=True):
        assert field.dtype == exact.dtype
        assert_allclose(field.astype(float), exact.astype(float), rtol=1e-3, atol=1e-6)
    assert np.array_equal(unpacked.brightness, coarse.brightness)


def test_every_second_point_is_kept() -> None:
    points = make_points(np.random.default_rng(5).normal(size=(3, DECIMATION_MIN_POINTS + 1)))
    unpacked = PackedPoints.pack(points).unpack()
    assert_allclose(unpacked.position_m, points.position_m[:, ::2], rtol=1e-6)


def test_gradients_beyond_half_precision_stay_finite() -> None:
    unpacked = PackedPoints.pack(make_points(np.full((3, 4), 1e6))).unpack()
    assert np.isfinite(unpacked.depth_gradient).all()
    assert np.isfinite(unpacked.brightness_variance).all()


def test_a_keyframe_takes_less_than_150_kilobytes(here: MapKeyframe) -> None:
    assert 20_000 < here.size_bytes < 150_000
    assert here.size_bytes > sum(level.attributes.nbytes for level in here.packed_points)


def placed(keyframe: MapKeyframe, *poses: Array) -> KeyframeDatabase:
    """The same keyframe at several poses."""
    keyframes = KeyframeDatabase(max_bytes=10**9)
    for number, T in enumerate(poses):
        keyframes.add(replace(keyframe, number=number, T_world_keyframe=T))
    return keyframes


def along(*positions_m: float) -> list[Array]:
    return [make_pose((path_m, 0.0, 0.0)) for path_m in positions_m]


def test_the_most_similar_of_the_allowed_keyframes_comes_first(
    recognizer: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    keyframes = KeyframeDatabase(max_bytes=10**9)
    keyframes.add(here)
    keyframes.add(elsewhere)
    view = make_query(recognizer, BESIDE)
    assert keyframes.find_similar(view, 2, lambda keyframe: True) == [here, elsewhere]
    assert keyframes.find_similar(view, 1, lambda keyframe: True) == [here]
    assert keyframes.find_similar(view, 5, lambda keyframe: keyframe.number > 0) == [elsewhere]
    assert keyframes.find_similar(view, 5, lambda keyframe: False) == []


def test_keyframes_are_found_by_their_numbers(here: MapKeyframe) -> None:
    keyframes = placed(here, *along(0.0, 1.0, 2.0))
    keyframes.remove(1)
    assert len(keyframes) == 2
    assert [keyframe.number for keyframe in keyframes] == [0, 2]
    assert 1 not in keyframes
    assert keyframes[2].number == 2
    with pytest.raises(KeyError):
        keyframes.remove(1)


def test_numbers_increase(here: MapKeyframe) -> None:
    keyframes = placed(here, *along(0.0, 1.0))
    with pytest.raises(ValueError, match="not newer"):
        keyframes.add(replace(here, number=1))


def test_the_database_reports_when_it_exceeds_its_limit(here: MapKeyframe) -> None:
    keyframes, is_over = KeyframeDatabase(max_bytes=int(2.5 * here.size_bytes)), []
    for number in range(3):
        keyframes.add(replace(here, number=number))
        is_over.append(keyframes.is_over_capacity)
    keyframes.remove(1)
    assert [*is_over, keyframes.is_over_capacity] == [False, False, True, False]
    assert keyframes.size_bytes == 2 * here.size_bytes
