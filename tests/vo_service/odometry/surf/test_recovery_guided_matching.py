import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, transform_points
from tests.vo_service.odometry.hand_held_sequence import hand_held_poses
from tests.vo_service.odometry.synthetic_views import CAMERA, render_corner
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.features.points import backproject_features
from vo_service.odometry.features.views import FeatureView, select_pairs_with_depth
from vo_service.odometry.motion_model import MotionPrediction
from vo_service.odometry.surf.recovery import match_by_prediction, match_within_radius

SPREAD_RAD = 0.04


def seen(frame: RgbdFrame) -> FeatureView:
    features = SurfExtractor(600).extract(frame.gray)
    return FeatureView(features, backproject_features(features, frame), frame.camera, frame.stamp_s)


@pytest.fixture(scope="module")
def reference() -> FeatureView:
    return seen(render_corner(hand_held_poses(1)[0]))


@pytest.fixture(scope="module")
def moved() -> FeatureView:
    return seen(render_corner(hand_held_poses(5)[4], 4))


def off_px(
    view: FeatureView, reference: FeatureView, pairs: NDArray[np.int64], T_reference_camera: Array
) -> Array:
    """How far each match is from where a motion puts it."""
    P = transform_points(inverse(T_reference_camera), reference.points.position_m[pairs[:, 1]])
    expected = P[:, :2] / P[:, 2:] * CAMERA.fx + [CAMERA.cx, CAMERA.cy]
    distance: Array = np.linalg.norm(view.features.position_px[pairs[:, 0]] - expected, axis=1)
    return distance


def test_a_right_prediction_gives_more_matches(reference: FeatureView, moved: FeatureView) -> None:
    T = hand_held_poses(5)[4]
    guided = match_by_prediction(moved, reference, MotionPrediction(T, SPREAD_RAD))
    plain = select_pairs_with_depth(
        moved, reference, match_features(moved.features, reference.features, 0.8)
    )
    assert len(guided) > len(plain) + 10
    assert np.median(off_px(moved, reference, guided, T)) < 1.0


def test_matches_are_near_the_prediction(reference: FeatureView, moved: FeatureView) -> None:
    T = hand_held_poses(7)[6]
    pairs = match_by_prediction(moved, reference, MotionPrediction(T, SPREAD_RAD))
    assert len(pairs) > 50
    assert off_px(moved, reference, pairs, T).max() <= CAMERA.fx * np.tan(SPREAD_RAD)


def test_each_feature_is_matched_once_with_its_own_sign(
    reference: FeatureView, moved: FeatureView
) -> None:
    pairs = match_by_prediction(moved, reference, MotionPrediction(np.eye(4), 0.2))
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
    assert np.all(np.diff(pairs[:, 0]) > 0)
    signs = moved.features.sign[pairs[:, 0]], reference.features.sign[pairs[:, 1]]
    np.testing.assert_array_equal(*signs)
    assert moved.points.has_depth[pairs[:, 0]].all()
    assert reference.points.has_depth[pairs[:, 1]].all()


@pytest.mark.parametrize(
    "T",
    [
        rigid_transform(so3_exp([0.0, 3.1, 0.0]), np.zeros(3)),  # all lies behind it
        rigid_transform(np.eye(3), [0.0, 0.0, 50.0]),
        rigid_transform(np.eye(3), [40.0, 0.0, 0.0]),
    ],
)
def test_a_prediction_out_of_view_gives_no_match(
    reference: FeatureView, moved: FeatureView, T: Array
) -> None:
    assert match_by_prediction(moved, reference, MotionPrediction(T, SPREAD_RAD)).shape == (0, 2)


def test_a_view_without_features_gives_no_match(reference: FeatureView) -> None:
    black = render_corner(hand_held_poses(1)[0])
    black.color_bgr[:] = 0
    empty = seen(black)
    assert match_by_prediction(empty, reference, MotionPrediction(np.eye(4), SPREAD_RAD)).shape == (
        0,
        2,
    )
    assert match_by_prediction(reference, empty, MotionPrediction(np.eye(4), SPREAD_RAD)).shape == (
        0,
        2,
    )


def found(
    sought: list[list[int]], descriptors: list[list[int]], radius_px: float = 5.0
) -> list[int]:
    """All are sought in one place; those to be found stand one pixel apart from there on."""
    expected_px = np.zeros((len(sought), 2))
    position_px = np.array([[float(n), 0.0] for n in range(len(descriptors))])
    vectors = (np.array(each, np.int16) for each in (sought, descriptors))
    a, b = vectors
    return [int(n) for n in match_within_radius(expected_px, a, position_px, b, radius_px)]


def test_the_nearest_descriptor_matches_if_it_is_distinct() -> None:
    assert found([[100, 0]], [[0, 100], [90, 0], [50, 0]]) == [1]
    assert found([[100, 0]], [[90, 0], [90, 1]]) == [-1]


def test_a_different_descriptor_is_no_match_even_without_an_alternative() -> None:
    assert found([[100, 0]], [[0, 100]]) == [-1]
    assert found([[100, 0]], [[80, 20]]) == [0]


def test_features_outside_the_search_radius_are_ignored() -> None:
    far = [[0, 100]] * 6 + [[100, 0]]
    assert found([[100, 0]], far, radius_px=6.5) == [6]
    assert found([[100, 0]], far, radius_px=5.5) == [-1]


def test_of_two_features_with_one_match_the_nearer_gets_it() -> None:
    assert found([[80, 0], [99, 0]], [[100, 0]]) == [-1, 0]
