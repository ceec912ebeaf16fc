"""Where the camera goes on along what a plain view leaves open."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, adjoint, inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, series_exponential
from tests.vo_service.odometry.direct.tracking_results import MOTION, STAMP_S, make_result
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.direct.motion_state import MotionState, fuse_with_prediction
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.uncertainty import DegeneracyAnalysis

OFF = np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])
FASTER = 0.3 * OFF
# Translation and rotation along x are unconstrained.
OPEN = np.array([True, False, False, True, False, False])
SURE, UNSURE = 1e-6, 10.0
# No information is noise.
CLEAR = np.full(6, 1e12)
# Sigma of the prediction at the stamp.
STRAYED = np.repeat((STAMP_S - MOTION.well_constrained_stamp_s) * np.array(VELOCITY_SIGMA), 3)


def fuse(
    sigma: Array, observability: Array = CLEAR, way: MotionState = MOTION
) -> tuple[TrackingResult, MotionUncertainty]:
    """What becomes of a motion that is found with standard deviations sigma (6,)."""
    # The directions are in the camera's axes, the analysis in the keyframe's.
    axes = adjoint(inverse(make_result(OFF, FASTER).alignment.T_camera_keyframe))
    uncertainty = MotionUncertainty(np.diag(sigma**2), DegeneracyAnalysis(observability, axes))
    return fuse_with_prediction(make_result(OFF, FASTER), uncertainty, way, STAMP_S)


def test_unconstrained_directions_are_predicted_and_the_others_measured() -> None:
    found, _ = fuse(np.where(OPEN, UNSURE, SURE))
    expected = BRISK.pose_at(STAMP_S) @ series_exponential(np.where(OPEN, 0.0, OFF))
    np.testing.assert_allclose(found.T_world_camera, expected, atol=1e-5)
    velocity = BRISK.velocity + np.where(OPEN, 0.0, FASTER)
    np.testing.assert_allclose(found.alignment.camera_velocity, velocity, atol=1e-5)


def test_directions_with_only_noise_are_predicted_and_reported() -> None:
    found, uncertainty = fuse(np.full(6, SURE), np.where(OPEN, 1.0, 1e12))
    expected = BRISK.pose_at(STAMP_S) @ series_exponential(np.where(OPEN, 0.0, OFF))
    np.testing.assert_allclose(found.T_world_camera, expected, atol=1e-5)
    sigma = np.sqrt(np.diag(uncertainty.covariance))
    np.testing.assert_allclose(sigma, np.where(OPEN, STRAYED, SURE), rtol=1e-3)
    assert (
        found.degradation
        == uncertainty.rejection_reason
        == "degenerate view: 2 of 6 degrees of freedom are unconstrained"
    )


def test_equal_uncertainties_are_averaged() -> None:
    found, uncertainty = fuse(STRAYED)
    expected = BRISK.pose_at(STAMP_S) @ series_exponential(0.5 * OFF)
    np.testing.assert_allclose(found.T_world_camera, expected, atol=1e-9)
    np.testing.assert_allclose(uncertainty.covariance, np.diag(0.5 * STRAYED**2), atol=1e-12)


def test_the_older_the_last_constrained_view_the_more_weight_has_the_measurement() -> None:
    held_of_late, _ = fuse(STRAYED)
    held_long_ago, _ = fuse(
        STRAYED, way=replace(MOTION, well_constrained_stamp_s=MOTION.well_constrained_stamp_s - 0.3)
    )
    late, long_ago = (
        np.linalg.norm(found.T_world_camera - make_result(OFF, FASTER).T_world_camera)
        for found in (held_of_late, held_long_ago)
    )
    assert 0.0 < long_ago < 0.05 * late


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_the_information_is_the_sum_of_both(seed: int) -> None:
    A = np.random.default_rng(seed).normal(scale=0.01, size=(6, 6))
    covariance = A @ A.T + 1e-8 * np.eye(6)
    uncertainty = MotionUncertainty(covariance, DegeneracyAnalysis(CLEAR, np.eye(6)))
    _, both = fuse_with_prediction(make_result(OFF, FASTER), uncertainty, MOTION, STAMP_S)
    information = np.linalg.inv(covariance) + np.diag(STRAYED**-2.0)
    np.testing.assert_allclose(both.covariance @ information, np.eye(6), atol=1e-6)
    assert both.covariance == pytest.approx(both.covariance.T, abs=0.0)
