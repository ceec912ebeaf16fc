"""Motions that are rejected, and doubt that the covariance covers."""

import numpy as np

from drivers.core.geometry import Array, inverse, rigid_transform, so3_log, transform_points
from tests.vo_service.odometry.point_pairs import (
    T_REFERENCE_CAMERA,
    make_exact_pairs,
    make_noisy_pairs,
    sample_points,
)
from tests.vo_service.odometry.synthetic_views import CAMERA, make_frame
from vo_service.odometry.depth_grid import DepthGrid
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.match_verifier import LAST_VIEW_VERIFIER
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import PointPairs, backproject_features
from vo_service.odometry.features.verification import cover_doubt, doubt_reason, rejection_reason
from vo_service.odometry.features.views import FeatureView
from vo_service.odometry.ransac import RigidMotionEstimate, find_consensus, refine_rigid_motion

PARAMETERS = SurfParameters()


def make_view(depth_m: float) -> FeatureView:
    image_m = np.full((CAMERA.height, CAMERA.width), depth_m)
    frame = make_frame(np.full(image_m.shape, 128, np.uint8), image_m)
    features = SurfExtractor().extract(frame.gray)
    points = backproject_features(features, frame)
    return FeatureView(features, points, CAMERA, 0.0, DepthGrid.of(frame.depth_m, CAMERA))


def make_motion(inliers: int, matches: int) -> RigidMotionEstimate:
    return RigidMotionEstimate(np.eye(4), np.arange(matches) < inliers, 1e-6 * np.eye(6))


def reject(motion: RigidMotionEstimate, depth_m: float = 2.0) -> str:
    view, reference = make_view(2.0), make_view(depth_m)
    return rejection_reason(view, reference, motion, LAST_VIEW_VERIFIER, PARAMETERS)


def fit(pairs: PointPairs) -> RigidMotionEstimate:
    return refine_rigid_motion(find_consensus(pairs, 500, 1), pairs)


def sigma_m(covariance: Array) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def test_consensus_by_chance_is_rejected() -> None:
    assert reject(make_motion(14, 60)) == "only 14 of 60 matches agree: may be chance"
    assert reject(make_motion(15, 600)) == "only 15 of 600 matches agree: may be chance"
    assert reject(make_motion(15, 60)) == ""


def test_a_minority_of_the_matches_that_contradicts_depth_is_rejected() -> None:
    minority = make_motion(90, 200)
    assert reject(minority, depth_m=2.0) == ""
    assert reject(minority, depth_m=2.5) == (
        "only 90 of 200 matches agree, and 100 % of the depth contradicts"
    )


def test_a_majority_of_the_matches_is_not_overruled_by_depth() -> None:
    assert reject(make_motion(110, 200), depth_m=2.5) == ""


def test_noise_beyond_the_model_increases_the_covariance() -> None:
    pairs = make_noisy_pairs(seed=1, n=200, outliers=0)
    told = fit(pairs)
    noisier = PointPairs(
        pairs.P_camera, pairs.P_reference, pairs.sigma_across_m / 2, pairs.sigma_along_m / 2
    )
    # In standard deviations, all distances are twice as large.
    ratio = sigma_m(cover_doubt(told, noisier, PARAMETERS).covariance) / sigma_m(
        cover_doubt(told, pairs, PARAMETERS).covariance
    )
    np.testing.assert_allclose(ratio, 2.0, rtol=1e-6)


def test_wrong_matches_that_are_few_do_not_matter() -> None:
    few = make_noisy_pairs(seed=2, n=200, outliers=20)
    covered = cover_doubt(fit(few), few, PARAMETERS)
    assert doubt_reason(covered.covariance, PARAMETERS) == ""


def make_two_motions(n: int, moved: int) -> PointPairs:
    """Points of a room, of which the last `moved` are on an object that moves by 0.2 m."""
    P = sample_points(np.random.default_rng(3), n)
    Q = transform_points(T_REFERENCE_CAMERA, P)
    Q[n - moved :, 0] += 0.2
    return make_exact_pairs(P, Q)


def test_the_covariance_covers_a_rival_motion() -> None:
    pairs = make_two_motions(200, moved=80)
    covered = cover_doubt(fit(pairs), pairs, PARAMETERS)
    rival = rigid_transform(np.eye(3), [0.2, 0.0, 0.0]) @ T_REFERENCE_CAMERA
    error = inverse(covered.T_reference_camera) @ rival
    twist = np.concatenate([error[:3, 3], so3_log(error[:3, :3])])
    assert twist @ np.linalg.solve(covered.covariance, twist) < 1.1
    assert "the matches agree poorly: off by up to 60 cm" in doubt_reason(
        covered.covariance, PARAMETERS
    )


def test_a_small_moving_object_is_no_rival() -> None:
    pairs = make_two_motions(200, moved=40)
    covered = cover_doubt(fit(pairs), pairs, PARAMETERS)
    assert doubt_reason(covered.covariance, PARAMETERS) == ""
