"""Checks of estimates, for all methods."""

import numpy as np

from drivers.core.geometry import is_rigid
from vo_service.types.estimate import Estimate


def assert_valid(estimate: Estimate) -> None:
    """Check for rigid poses, finite numbers, and a reason if there is no motion."""
    assert is_rigid(estimate.T_world_camera)
    assert is_rigid(estimate.T_reference_camera)
    assert np.all(np.isfinite(estimate.covariance))
    assert estimate.ok or estimate.reason


def assert_valid_or_explained(estimate: Estimate) -> None:
    """Check the same for a method without degraded results: only failures have a reason."""
    assert_valid(estimate)
    assert estimate.ok == (estimate.reason == "")


def assert_starts_at_origin(first: Estimate) -> None:
    """Check that the first good frame's pose is exactly the origin."""
    assert first.ok
    assert not first.is_reset
    assert np.array_equal(first.T_world_camera, np.eye(4))
    assert not first.covariance.any()
    assert (first.matches, first.inliers) == (0, 0)


def assert_counts_consistent(estimate: Estimate, min_inliers: int) -> None:
    """Check that counts and debug data agree, and that the covariance is positive definite."""
    evidence = estimate.debug
    assert min_inliers <= estimate.inliers <= estimate.matches <= estimate.features
    assert evidence.keypoints_px.shape == (estimate.features, 2)
    assert evidence.matches_px.shape == evidence.reference_matches_px.shape
    assert evidence.inlier.shape == (estimate.matches,)
    assert int(evidence.inlier.sum()) == estimate.inliers
    assert np.linalg.eigvalsh(estimate.covariance).min() > 0
