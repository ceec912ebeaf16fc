import numpy as np
from numpy.testing import assert_allclose

from drivers.geometry import inverse, transform_points
from tests.vo_service.mapping.places.corner_places import HERE, STANDING
from tests.vo_service.odometry.keyframe.rolling_views import BRISK
from tests.vo_service.odometry.synthetic_views import CAMERA, view_of_a_corner
from vo_service.mapping.places.landmarks import at_stamp, find_landmarks
from vo_service.odometry.points import locate_features
from vo_service.odometry.surf import SurfExtractor

READOUT_S = 0.03


def test_landmarks_are_the_strongest_features_with_depth() -> None:
    frame = view_of_a_corner(HERE)
    features = SurfExtractor(200).extract(frame.grey)
    with_depth = np.flatnonzero(locate_features(features, frame).has_depth)[:50]
    found = find_landmarks(frame, SurfExtractor(200), STANDING, most=50)
    assert len(found) == 50
    assert np.array_equal(found.sign, features.sign[with_depth])
    assert_allclose(found.descriptor, np.minimum(features.descriptor[with_depth], 127.0))


def test_points_seen_by_other_rows_are_brought_to_the_stamp() -> None:
    P_world = np.random.default_rng(2).uniform((-0.5, -0.5, 1.5), (0.5, 0.5, 3.0), (40, 3))
    rows_px = np.random.default_rng(3).uniform(0, CAMERA.height - 1, 40)
    seen = np.empty_like(P_world)
    for n, row_px in enumerate(rows_px):
        instant_s = (row_px - 0.5 * (CAMERA.height - 1)) * READOUT_S / CAMERA.height
        seen[n] = transform_points(inverse(BRISK.at(instant_s)), P_world[n : n + 1])[0]
    settled = at_stamp(seen, rows_px, CAMERA.height, READOUT_S, BRISK.movement)
    assert np.abs(seen - P_world).max() > 5e-3
    assert_allclose(settled, P_world, atol=2e-5)


def test_points_of_an_instant_stay_where_they_are() -> None:
    P = np.random.default_rng(4).normal(size=(5, 3))
    assert np.array_equal(at_stamp(P, np.arange(5.0), 480, 0.0, BRISK.movement), P)
