"""Where the camera goes on along what a plain view leaves open."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import PosePrior
from drivers.core.geometry import Array, adjoint, inverse, is_rigid
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, series_exponential
from tests.vo_service.odometry.direct.tracking_results import MOTION, STAMP_S, make_result
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.pose_filter import (
    contradiction_reason,
    fade_innovation,
    fuse_with_prediction,
)
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.uncertainty import DegeneracyAnalysis

OFF = np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])
FASTER = 0.3 * OFF
# Translation and rotation along x are unconstrained.
OPEN = np.array([True, False, False, True, False, False])
SURE = 1e-6
# No information is noise.
CLEAR = np.full(6, 1e12)
TOLD = PosePrior(series_exponential(0.5 * OFF), 1e6 * np.eye(6), np.zeros((6, 6)), "wheel odometry")
STEADY = replace(MOTION, velocity_noise=np.zeros(2))
# Sigma of the prediction at the stamp.
STRAYED = np.repeat((STAMP_S - MOTION.well_constrained_stamp_s) * np.array(VELOCITY_SIGMA), 3)


def fuse(
    sigma: Array,
    observability: Array = CLEAR,
    way: MotionState = MOTION,
    off: Array = OFF,
    is_one_plane: bool = False,
) -> tuple[TrackingResult, MotionUncertainty]:
    """What becomes of a motion that is found with standard deviations sigma (6,)."""
    # The directions are in the camera's axes, the analysis in the keyframe's.
    axes = adjoint(inverse(make_result(off, FASTER).alignment.T_camera_keyframe))
    degeneracy = DegeneracyAnalysis(observability, axes)
    uncertainty = MotionUncertainty(np.diag(sigma**2), degeneracy, is_one_plane=is_one_plane)
    return fuse_with_prediction(make_result(off, FASTER), uncertainty, way, STAMP_S)[:2]


def test_directions_with_only_noise_are_predicted_and_reported() -> None:
    found, uncertainty = fuse(np.full(6, SURE), np.where(OPEN, 1.0, 1e12), STEADY)
    expected = BRISK.pose_at(STAMP_S) @ series_exponential(np.where(OPEN, 0.0, OFF))
    np.testing.assert_allclose(found.T_world_camera, expected, atol=1e-5)
    sigma = np.sqrt(np.diag(uncertainty.covariance))
    np.testing.assert_allclose(sigma, np.where(OPEN, STRAYED, SURE), rtol=1e-3)
    assert (
        found.degradation
        == uncertainty.rejection_reason
        == "degenerate view: 2 of 6 degrees of freedom are unconstrained"
    )


def test_the_prediction_of_an_unsteady_camera_is_less_certain() -> None:
    unsteady = replace(MOTION, velocity_noise=3.0 * np.array(VELOCITY_SIGMA))
    _, uncertainty = fuse(np.full(6, SURE), np.where(OPEN, 1.0, 1e12), unsteady)
    sigma = np.sqrt(np.diag(uncertainty.covariance))
    np.testing.assert_allclose(sigma, np.where(OPEN, 3.0 * STRAYED, SURE), rtol=1e-3)


def test_one_plane_leaves_three_directions_open() -> None:
    weak = np.array([4.0, 6.0, 11.0, 40.0, 50.0, 60.0])
    _, uncertainty = fuse(np.full(6, SURE), weak, STEADY, is_one_plane=True)
    assert uncertainty.rejection_reason.startswith("degenerate view: 3 of 6")
    sigma = np.sqrt(np.diag(uncertainty.covariance))
    np.testing.assert_allclose(sigma[:3], STRAYED[:3], rtol=1e-3)
    assert np.all(sigma[3:] < 2.0 * SURE)


def test_a_direction_that_is_weak_or_open_has_an_error_of_one_sign() -> None:
    rest = np.full(5, 40.0)
    seen = {
        ratio: fuse(np.full(6, SURE), np.array([ratio, *rest]), STEADY)[1] for ratio in (2, 5, 9)
    }
    assert {ratio: one.has_biased_error for ratio, one in seen.items()} == {
        2: True,
        5: True,
        9: False,
    }


def contradiction(observability: Array, way: MotionState, off: Array) -> str:
    """Why a motion is rejected that is found off (6,) the prediction, with sigmas of 1 mm."""
    axes = adjoint(inverse(make_result(off, FASTER).alignment.T_camera_keyframe))
    uncertainty = MotionUncertainty(1e-6 * np.eye(6), DegeneracyAnalysis(observability, axes))
    return contradiction_reason(make_result(off, FASTER), uncertainty, way, STAMP_S)


def test_a_jump_in_a_constrained_direction_of_a_degenerate_view_is_rejected() -> None:
    jump, degenerate = np.eye(6)[1] * 0.1, np.where(OPEN, 1.0, 1e12)
    assert contradiction(degenerate, STEADY, jump).startswith("degenerate view: the motion contra")
    assert contradiction(degenerate, STEADY, np.eye(6)[0] * 0.1) == ""
    assert contradiction(degenerate, STEADY, 0.01 * jump) == ""
    assert contradiction(degenerate, replace(STEADY, pose_prior=TOLD), jump) == ""


def test_a_jump_after_a_degenerate_view_is_rejected_unless_it_was_long_ago() -> None:
    jump = np.eye(6)[1] * 0.1
    extrapolated = replace(STEADY, well_constrained_stamp_s=STEADY.stamp_s - 0.03)
    assert contradiction(CLEAR, extrapolated, jump) != ""
    assert contradiction(CLEAR, STEADY, jump) == ""
    assert contradiction(CLEAR, replace(extrapolated, stamp_s=0.8), jump) == ""


def test_noise_hardly_moves_a_calm_camera() -> None:
    sigma = np.full(6, 0.05)
    calm, _ = fuse(sigma)
    moved = inverse(BRISK.pose_at(STAMP_S)) @ calm.T_world_camera
    np.testing.assert_allclose(moved[:3, 3], OFF[:3] / 11.0, atol=1e-4)
    change = calm.alignment.camera_velocity - BRISK.velocity
    np.testing.assert_allclose(change, FASTER / 121.0, atol=1e-6)


def test_what_wheels_tell_is_counted_once_in_a_good_view() -> None:
    without, _ = fuse(np.full(6, 0.05))
    told, _ = fuse(np.full(6, 0.05), way=replace(MOTION, pose_prior=TOLD))
    np.testing.assert_array_equal(told.T_world_camera, without.T_world_camera)
    np.testing.assert_array_equal(told.alignment.motion, without.alignment.motion)


def test_a_degenerate_view_goes_on_with_pose_and_velocity_of_the_wheels() -> None:
    blind = np.full(6, 1e3), np.ones(6)
    found, _ = fuse(*blind, way=replace(STEADY, pose_prior=TOLD))
    assert found.degradation == "degenerate view: wheel odometry"
    expected = STEADY.T_world_camera @ TOLD.T_last_camera
    np.testing.assert_allclose(found.T_world_camera, expected, atol=1e-5)
    velocity = 0.5 * OFF / (STAMP_S - STEADY.stamp_s)
    np.testing.assert_allclose(found.alignment.camera_velocity, velocity, atol=1e-4)


def test_a_motion_beyond_the_noise_is_followed_at_once() -> None:
    followed, _ = fuse(np.full(6, 1e-3))
    measured = make_result(OFF, FASTER)
    np.testing.assert_allclose(followed.T_world_camera, measured.T_world_camera, atol=5e-4)


def test_a_camera_that_moved_recently_is_not_calm() -> None:
    moving = replace(MOTION, normalized_innovation=100.0)
    followed, _ = fuse(np.full(6, 0.05), way=moving)
    measured = make_result(OFF, FASTER)
    np.testing.assert_allclose(followed.T_world_camera, measured.T_world_camera, atol=5e-4)


def test_an_innovation_counts_at_once_and_decays() -> None:
    assert fade_innovation(0.0, 9.0) == 9.0
    assert 0.0 < fade_innovation(9.0, 0.0) < 9.0


def test_after_a_long_time_nothing_is_fused() -> None:
    followed, _ = fuse(np.full(6, 0.05), way=replace(MOTION, stamp_s=0.5))
    np.testing.assert_array_equal(followed.T_world_camera, make_result(OFF, FASTER).T_world_camera)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_the_gain_keeps_rotations_rigid(seed: int) -> None:
    A = np.random.default_rng(seed).normal(scale=0.01, size=(6, 6))
    uncertainty = MotionUncertainty(
        A @ A.T + 1e-8 * np.eye(6), DegeneracyAnalysis(CLEAR, np.eye(6))
    )
    fused, *_ = fuse_with_prediction(make_result(OFF, FASTER), uncertainty, MOTION, STAMP_S)
    assert is_rigid(fused.T_world_camera, 1e-9)
