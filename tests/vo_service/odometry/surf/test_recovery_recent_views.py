import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, adjoint, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.synthetic_views import CAMERA, make_textured_image
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.points import FeaturePoints
from vo_service.odometry.features.views import FeatureView
from vo_service.odometry.surf.recovery import MAX_VIEWS, RecentViews

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
