"""The profile for a small board: fewer points and levels, and features only on demand."""

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    MovingCamera,
    add_noise,
    render_sequence,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import POINT_BLOCKS, SMALL_POINT_BLOCKS
from vo_service.odometry.features.extractor import Features, SurfExtractor
from vo_service.odometry.registry import make_odometry


class CountingExtractor(SurfExtractor):
    """Counts the images whose features were extracted."""

    images = 0

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        self.images += 1
        return super().extract(gray)


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [add_noise(frame, k) for k, frame in enumerate(render_sequence(BRISK, 6))]


def points_of(odometry: DirectOdometry) -> list[int]:
    """Points of the active keyframe by level."""
    assert odometry.active_keyframe is not None
    return [len(level.brightness) for level in odometry.active_keyframe.points]


def test_the_profile_has_half_the_points_on_three_levels() -> None:
    kinect = PinholeCamera(640, 480, 580.0, 580.0, 319.5, 239.5)
    frame = render_view(camera=kinect)
    counts = {}
    for profile, blocks in (("default", POINT_BLOCKS), ("small", SMALL_POINT_BLOCKS)):
        odometry = DirectOdometry(point_blocks=blocks)
        odometry.estimate(frame)
        counts[profile] = points_of(odometry)
    assert len(counts["default"]) == 4
    assert len(counts["small"]) == 3
    for small, default in zip(counts["small"], counts["default"], strict=False):
        assert 0.4 < small / default < 0.65


def test_a_camera_in_a_corner_is_tracked(views: list[RgbdFrame]) -> None:
    odometry = make_odometry(profile="small", timing="fixed")
    for k, estimate in enumerate(estimate_all(odometry, views)):
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.002, 0.06)


def looking(angle_rad: float, k: int) -> RgbdFrame:
    T = rigid_transform(so3_exp([0.0, angle_rad, 0.0]), [0.3 * angle_rad, 0.0, 0.0])
    return add_noise(render_view(MovingCamera(T_world_start=T), k / 30), k)


def test_features_are_extracted_for_the_recovery_only() -> None:
    extractor = CountingExtractor()
    odometry = DirectOdometry(extractor, point_blocks=SMALL_POINT_BLOCKS)
    estimates = estimate_all(odometry, [looking(0.06 * k, k) for k in range(9)])
    assert all(estimate.ok for estimate in estimates)
    assert len(odometry.keyframes) >= 3
    assert {len(keyframe.points) for keyframe in odometry.keyframes} == {3}
    assert extractor.images == 0
    odometry.estimate(looking(0.06 * 8 + 0.4, 9))
    assert extractor.images > 0
