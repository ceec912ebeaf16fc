import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import (
    Array,
    adjoint,
    inverse,
    rigid_transform,
    so3_exp,
    transform_points,
)
from tests.vo_service.odometry.hand_held_sequence import hand_held_poses
from tests.vo_service.odometry.synthetic_views import CAMERA, make_textured_image, render_corner
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.features.points import FeaturePoints, backproject_features
from vo_service.odometry.features.views import FeatureView, select_pairs_with_depth
from vo_service.odometry.motion_model import MotionPrediction
from vo_service.odometry.surf.recovery import (
    MAX_VIEWS,
    RecentViews,
    match_by_prediction,
    match_within_radius,
)

STEP_COVARIANCE = np.diag([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6])


FEATURES = SurfExtractor(5).extract(make_textured_image(64, 64))
NONE = np.zeros(len(FEATURES))
POINTS = FeaturePoints(np.zeros((len(FEATURES), 3)), NONE > 0, NONE, NONE)


def view(stamp_s: float) -> FeatureView:
    """A view of nothing in particular."""
    return FeatureView(FEATURES, POINTS, CAMERA, stamp_s)


def at(x_m: float, turn_rad: float = 0.0) -> Array:
    return rigid_transform(so3_exp([0.0, turn_rad, 0.0]), [x_m, 0.0, 0.0])


def walked(poses: list[Array]) -> tuple[RecentViews, FeatureView]:
    """What is kept after a walk, and the last view of it; a view is stamped with its number."""
    views = RecentViews()
    last = view(0.0)
    views.reset(last, poses[0])
    for k in range(1, len(poses)):
        last = view(float(k))
        views.add(last, poses[k], inverse(poses[k - 1]) @ poses[k], STEP_COVARIANCE)
    return views, last


def kept(poses: list[Array]) -> list[float]:
    views, last = walked(poses)
    return [each.view.stamp_s for each in views.excluding(last)]


def test_a_camera_at_rest_is_stored_once() -> None:
    assert kept([at(0.0)] * 50) == [0.0]


def test_distant_views_are_stored_and_the_last_one_comes_first() -> None:
    assert kept([at(0.0), at(1.0), at(1.0, 0.5), at(1.1, 0.5)]) == [2.0, 1.0, 0.0]


def test_the_last_view_itself_is_not_returned() -> None:
    assert kept([at(0.0), at(1.0)]) == [0.0]
    assert kept([at(0.0)]) == []


def test_the_least_recently_seen_view_is_replaced() -> None:
    poses = [at(float(k)) for k in range(MAX_VIEWS + 3)]
    assert kept(poses) == [float(k) for k in range(MAX_VIEWS + 1, 2, -1)]


def test_a_revisited_view_counts_as_the_most_recent() -> None:
    assert kept([at(0.0), at(1.0), at(2.0), at(0.1)]) == [0.0, 2.0, 1.0]


def test_a_new_world_frame_drops_the_old_views() -> None:
    views, _ = walked([at(0.0), at(1.0), at(2.0)])
    first = view(9.0)
    views.reset(first, at(2.0))
    assert views.excluding(first) == []


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), min_size=3, max_size=20))
def test_each_views_covariance_is_accumulated_since_then(
    walk: list[tuple[float, float]],
) -> None:
    poses = [at(*place) for place in walk]
    views, last = walked(poses)
    for each in views.excluding(last):
        begin = int(each.view.stamp_s)
        expected = np.zeros((6, 6))
        for before, after in zip(poses[begin:], poses[begin + 1 :], strict=False):
            Ad = adjoint(inverse(after) @ before)
            expected = Ad @ expected @ Ad.T + STEP_COVARIANCE
        np.testing.assert_allclose(each.covariance, expected, rtol=1e-9, atol=1e-15)
        np.testing.assert_array_equal(each.T_world_view, poses[begin])


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
