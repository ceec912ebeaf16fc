import numpy as np
from numpy.testing import assert_allclose

from drivers.core.geometry import inverse, transform_points
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK
from tests.vo_service.odometry.synthetic_views import CAMERA, render_corner
from tests.vo_service.slam.corner_keyframes import HERE, ZERO_VELOCITY
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.points import backproject_features
from vo_service.slam.keyframe_database import (
    compensate_rolling_shutter,
    extract_depth_features,
)

READOUT_S = 0.03


def test_the_strongest_features_with_depth_are_kept() -> None:
    frame = render_corner(HERE)
    features = SurfExtractor(200).extract(frame.gray)
    with_depth = np.flatnonzero(backproject_features(features, frame).has_depth)[:50]
    found = extract_depth_features(frame, SurfExtractor(200), ZERO_VELOCITY, max_features=50)
    assert len(found) == 50
    assert np.array_equal(found.sign, features.sign[with_depth])
    assert_allclose(found.descriptor, np.minimum(features.descriptor[with_depth], 127.0))


def test_points_of_other_rows_are_moved_to_the_stamp() -> None:
    P_world = np.random.default_rng(2).uniform((-0.5, -0.5, 1.5), (0.5, 0.5, 3.0), (40, 3))
    rows_px = np.random.default_rng(3).uniform(0, CAMERA.height - 1, 40)
    seen = np.empty_like(P_world)
    for n, row_px in enumerate(rows_px):
        instant_s = (row_px - 0.5 * (CAMERA.height - 1)) * READOUT_S / CAMERA.height
        seen[n] = transform_points(inverse(BRISK.pose_at(instant_s)), P_world[n : n + 1])[0]
    compensated = compensate_rolling_shutter(seen, rows_px, CAMERA.height, READOUT_S, BRISK.motion)
    assert np.abs(seen - P_world).max() > 5e-3
    assert_allclose(compensated, P_world, atol=2e-5)


def test_points_of_a_global_shutter_stay() -> None:
    P = np.random.default_rng(4).normal(size=(5, 3))
    assert np.array_equal(compensate_rolling_shutter(P, np.arange(5.0), 480, 0.0, BRISK.motion), P)
