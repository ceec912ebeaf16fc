import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, inverse, is_rigid
from tests.vo_service.odometry.point_pairs import (
    T_REFERENCE_CAMERA,
    make_exact_pairs,
    make_noisy_pairs,
    sample_points,
)
from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES
from vo_service.odometry.features.points import PointPairs
from vo_service.odometry.ransac import Consensus, find_consensus, pair_weights, refine_rigid_motion


def error_of(T_reference_camera: Array) -> Array:
    """(translation, rotation) of the small motion that is missing."""
    difference = inverse(T_reference_camera) @ T_REFERENCE_CAMERA
    R = difference[:3, :3]
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return np.concatenate([difference[:3, 3], turn])


def test_refinement_is_much_closer_to_the_truth_than_three_points() -> None:
    coarse, fine = [], []
    for seed in range(40):
        pairs = make_noisy_pairs(seed, 200, 60)
        consensus = find_consensus(pairs, 500, 1)
        coarse.append(np.linalg.norm(error_of(consensus.T_reference_camera)[:3]))
        fine.append(
            np.linalg.norm(error_of(refine_rigid_motion(consensus, pairs).T_reference_camera)[:3])
        )
    assert np.median(fine) < 0.002
    assert np.median(fine) < 0.5 * np.median(coarse)


@pytest.mark.parametrize("seed", range(8))
def test_nearly_all_inliers_are_found_among_60_percent_outliers(seed: int) -> None:
    pairs = make_noisy_pairs(seed, 300, 180)
    motion = refine_rigid_motion(find_consensus(pairs, 500, seed), pairs)
    assert motion.inlier[:120].mean() > 0.9
    assert motion.inlier[120:].sum() <= 5


def test_refinement_recovers_inliers() -> None:
    pairs = make_noisy_pairs(0, 200, 60)
    some = np.zeros(200, np.bool_)
    some[:20] = True
    motion = refine_rigid_motion(Consensus(np.eye(4), some), pairs)
    assert motion.inlier[:140].mean() > 0.95
    assert motion.inlier[140:].sum() <= 3


def test_the_covariance_is_that_of_many_measurements() -> None:
    errors, covariances = [], []
    for seed in range(400):
        pairs = make_noisy_pairs(seed, 120, 20)
        motion = refine_rigid_motion(find_consensus(pairs, 500, 1), pairs)
        errors.append(error_of(motion.T_reference_camera))
        covariances.append(motion.covariance)
    predicted = np.sqrt(np.diag(np.mean(covariances, axis=0)))
    assert np.std(errors, axis=0) == pytest.approx(predicted, rel=0.25)


def test_near_points_have_more_weight_than_far_ones() -> None:
    P = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    near, far = pair_weights(make_exact_pairs(P, P))
    assert 9 < near / far < 81


@pytest.mark.parametrize("inliers", [0, 1, 2])
def test_fewer_than_three_inliers_give_no_motion(inliers: int) -> None:
    pairs = make_noisy_pairs(0, 20, 0)
    motion = refine_rigid_motion(Consensus(T_REFERENCE_CAMERA, np.arange(20) < inliers), pairs)
    assert np.array_equal(motion.T_reference_camera, np.eye(4))
    assert not motion.inlier.any()
    assert not motion.covariance.any()


def test_inliers_that_the_fit_rejects_are_no_error() -> None:
    random = np.random.default_rng(0)
    pairs = make_exact_pairs(sample_points(random, 30), sample_points(random, 30))
    motion = refine_rigid_motion(Consensus(np.eye(4), np.ones(30, np.bool_)), pairs)
    assert motion.inlier.sum() < 15


@FIRST_CALL_COMPILES
@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 3), max_size=12), st.integers(0, 2))
def test_points_on_lines_and_planes_are_no_error(rows: list[tuple[int, ...]], shift: int) -> None:
    P = np.array(rows, np.float64).reshape(-1, 3)
    sigma_m = np.full(len(P), 0.005)
    pairs = PointPairs(P, P + shift, sigma_m, sigma_m)
    motion = refine_rigid_motion(Consensus(np.eye(4), np.ones(len(P), np.bool_)), pairs)
    assert is_rigid(motion.T_reference_camera)
    assert np.all(np.isfinite(motion.covariance))
