"""Prediction from the motion state."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array, inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
)
from vo_service.odometry.direct.motion import change_frame
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA

T_WORLD_KEYFRAME = BRISK.pose_at(-0.3)
MOTION_STATE = MotionState(BRISK.pose_at(1.0), BRISK.velocity, 1.0)


def test_the_prediction_is_a_constant_velocity() -> None:
    moving = MOTION_STATE.predict_alignment(T_WORLD_KEYFRAME, 1.05)
    np.testing.assert_allclose(moving, inverse(BRISK.pose_at(1.05)) @ T_WORLD_KEYFRAME, atol=1e-12)


@pytest.mark.parametrize("stamp_s", [5.0, 1.0, 0.2])
def test_after_a_long_time_the_velocity_is_hardly_known(stamp_s: float) -> None:
    prior = MOTION_STATE.motion_prior(T_WORLD_KEYFRAME, stamp_s)
    assert prior.rate_hz == pytest.approx(0.25 if stamp_s > 1.0 else 0.0)
    assert np.all(prior.information < MOTION_STATE.motion_prior(T_WORLD_KEYFRAME, 1.03).information)


def test_after_a_few_frames_without_a_pose_the_prediction_is_uncertain() -> None:
    assert not MOTION_STATE.is_stale(1.0 + 2 / 30)
    assert MOTION_STATE.is_stale(1.0 + 1 / 6)


def test_the_velocity_is_predicted_in_the_keyframe_axes() -> None:
    prior = MOTION_STATE.motion_prior(T_WORLD_KEYFRAME, 1.05)
    T_keyframe_last = inverse(T_WORLD_KEYFRAME) @ BRISK.pose_at(1.0)
    np.testing.assert_allclose(prior.T_keyframe_last, T_keyframe_last, atol=1e-12)
    assert prior.rate_hz == pytest.approx(20.0)
    np.testing.assert_allclose(
        prior.motion, -change_frame(BRISK.motion, T_keyframe_last), atol=1e-12
    )


def test_velocity_changes_increase_the_velocity_noise_and_it_decays() -> None:
    calm = replace(MOTION_STATE, velocity_noise=np.zeros(2))
    np.testing.assert_array_equal(calm.update_velocity_noise(MOTION_STATE.velocity), [0.0, 0.0])
    jolted = calm.update_velocity_noise(
        MOTION_STATE.velocity + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    )
    assert jolted[0] > 0.0 == jolted[1]
    after = replace(calm, velocity_noise=jolted).update_velocity_noise(MOTION_STATE.velocity)
    assert 0.0 < after[0] < jolted[0]


def test_the_first_change_is_not_velocity_noise() -> None:
    assert np.isinf(MOTION_STATE.velocity_noise).all()
    standing = MOTION_STATE.update_velocity_noise(MOTION_STATE.velocity)
    np.testing.assert_array_equal(standing, [0.0, 0.0])
    moving = MOTION_STATE.update_velocity_noise(MOTION_STATE.velocity + 0.5)
    assert np.all(moving < 0.5)
    assert np.all(moving > np.array(VELOCITY_SIGMA))


def known_velocity(noise: float) -> Array:
    return (
        replace(MOTION_STATE, velocity_noise=np.full(2, noise))
        .motion_prior(T_WORLD_KEYFRAME, 1.03)
        .information
    )


def test_a_calm_camera_has_a_smaller_but_limited_velocity_covariance() -> None:
    usual, calm, dead = known_velocity(10.0), known_velocity(0.01), known_velocity(0.0)
    np.testing.assert_allclose(usual[:6], np.repeat(np.array(VELOCITY_SIGMA) ** -2, 3))
    assert np.all(usual < calm)
    assert np.all(calm < dead)
    assert np.isfinite(dead).all()


def test_calm_is_ignored_after_a_long_time() -> None:
    calm = replace(MOTION_STATE, velocity_noise=np.zeros(2))
    after = calm.motion_prior(T_WORLD_KEYFRAME, 5.0).information
    np.testing.assert_array_equal(
        after, MOTION_STATE.motion_prior(T_WORLD_KEYFRAME, 5.0).information
    )


def test_prediction_continues_from_the_next_good_frame() -> None:
    there = MOTION_STATE.advance(BRISK.pose_at(1.1), BRISK.velocity, 1.1, 1.2, 0.7, 1.1)
    assert there.gain == 1.2
    assert there.stamp_s == there.well_constrained_stamp_s == 1.1
    assert there.normalized_innovation == 0.7
    np.testing.assert_array_equal(
        there.velocity_noise, MOTION_STATE.update_velocity_noise(BRISK.velocity)
    )
    np.testing.assert_array_equal(there.T_world_camera, BRISK.pose_at(1.1))


def test_a_degenerate_view_tells_nothing_of_the_velocity_noise() -> None:
    there = MOTION_STATE.advance(BRISK.pose_at(1.1), BRISK.velocity, 1.1, 1.2, 0.7, -1.0)
    assert there.well_constrained_stamp_s == -1.0
    np.testing.assert_array_equal(there.velocity_noise, MOTION_STATE.velocity_noise)


@pytest.mark.parametrize(
    ("held_s", "stamp_s", "is_held"),
    [
        (0.7, 1.05, True),
        (0.6, 1.05, False),
        (1.0, 1.15, True),
        (1.0, 1.0, False),
        (1.0, 0.95, False),
    ],
)
def test_a_degenerate_view_is_extrapolated_for_a_moment(
    held_s: float, stamp_s: float, is_held: bool
) -> None:
    assert replace(MOTION_STATE, well_constrained_stamp_s=held_s).is_predictable(stamp_s) is is_held


def test_a_pose_is_extrapolated_if_the_last_good_frame_was_degenerate() -> None:
    assert not replace(MOTION_STATE, well_constrained_stamp_s=1.0).is_extrapolated
    assert replace(MOTION_STATE, well_constrained_stamp_s=0.9).is_extrapolated
