"""Pose filter of a calm and of a shaking camera."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, series_exponential
from tests.vo_service.odometry.direct.tracking_results import MOTION, STAMP_S, make_result
from vo_service.odometry.direct.motion_state import MotionState, alpha_beta_filter, filter_gains
from vo_service.odometry.direct.parameters import MIN_POSE_GAIN
from vo_service.odometry.direct.quality import TrackingResult

# A millimeter, and a milliradian.
SIGMA = 1e-3
OFF = SIGMA * np.array([0.5, -0.3, 0.2, 0.4, 0.1, -0.3])
FASTER = np.array([0.01, 0.02, -0.01, 0.02, 0.01, 0.03])


def filter_pose(
    times: float, way: MotionState = MOTION, stamp_s: float = STAMP_S
) -> tuple[TrackingResult, TrackingResult, float]:
    """The measured motion, the filtered motion and the velocity noise."""
    found = make_result(times * OFF, FASTER)
    return found, *alpha_beta_filter(found, SIGMA**2 * np.eye(6), way, stamp_s)


def test_a_calm_camera_is_hardly_moved_by_noise() -> None:
    _, calm, innovation = filter_pose(1.0)
    assert innovation == pytest.approx(np.mean((OFF / SIGMA) ** 2))
    expected = BRISK.pose_at(STAMP_S) @ series_exponential(MIN_POSE_GAIN * OFF)
    np.testing.assert_allclose(calm.T_world_camera, expected, atol=1e-12)
    change = calm.alignment.camera_velocity - BRISK.velocity
    np.testing.assert_allclose(change, filter_gains(innovation)[1] * FASTER, atol=1e-12)
    assert 0.0 < filter_gains(innovation)[1] < MIN_POSE_GAIN


def test_an_innovation_beyond_the_noise_is_used_fully() -> None:
    found, taken, _ = filter_pose(6.0)
    assert taken is found


def test_a_recently_shaking_camera_is_not_calm() -> None:
    found, taken, innovation = filter_pose(1.0, replace(MOTION, normalized_innovation=4.0))
    assert taken is found
    assert 1.0 < innovation < 4.0


def test_after_a_long_time_the_filter_has_no_prediction() -> None:
    found, taken, _ = filter_pose(1.0, replace(MOTION, stamp_s=0.5))
    assert taken is found


def test_the_weight_of_a_frame_grows_with_the_innovation() -> None:
    pose_gain, velocity_gain = np.array(
        [filter_gains(innovation) for innovation in (0.0, 1.3, 1.6, 2.0, 9.0)]
    ).T
    assert pose_gain[0] == MIN_POSE_GAIN
    assert np.all(np.diff(pose_gain[:4]) > 0)
    assert np.all(np.diff(velocity_gain[:3]) > 0)
    assert pose_gain[-1] == velocity_gain[-1] == 1.0
