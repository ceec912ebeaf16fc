"""Consensus of pairs by RANSAC, and its refinement."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import (
    Array,
    fit_rigid_motion,
    inverse,
    is_rigid,
    rigid_transform,
    rotation_angle_rad,
    so3_exp,
    transform_points,
)
from tests.vo_service.odometry.point_pairs import (
    T_REFERENCE_CAMERA,
    make_exact_pairs,
    make_noisy_pairs,
    sample_points,
)
from tests.vo_service.odometry.synthetic_views import FIRST_CALL_COMPILES
from vo_service.odometry.features.points import PointPairs
from vo_service.odometry.ransac import (
    Consensus,
    find_best_hypothesis,
    find_consensus,
    find_inliers,
    inverse_gate,
    pair_weights,
    refine_rigid_motion,
)

SEED = st.integers(0, 2**31 - 1)

COORDINATE = st.floats(-4.0, 4.0)


def consensus_of(P: Array, Q: Array) -> tuple[Array, int]:
    found = find_consensus(make_exact_pairs(P, Q), 500, 1)
    return found.T_reference_camera, int(found.inlier.sum())


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("outliers", [0, 150, 180])
def test_the_motion_is_found_among_outliers(seed: int, outliers: int) -> None:
    found = find_consensus(make_noisy_pairs(seed, 300, outliers), 500, seed)
    error = inverse(found.T_reference_camera) @ T_REFERENCE_CAMERA
    assert np.linalg.norm(error[:3, 3]) < 0.02
    assert np.degrees(rotation_angle_rad(error[:3, :3])) < 0.8
    good = 300 - outliers
    assert found.inlier[:good].mean() > 0.75  # of three noisy points; refined later
    assert found.inlier[good:].sum() <= 5


@FIRST_CALL_COMPILES
@given(SEED)
def test_the_motion_of_three_pairs_is_that_of_the_svd(seed: int) -> None:
    random = np.random.default_rng(seed)
    P = sample_points(random, 3)
    T = rigid_transform(so3_exp(random.uniform(-1, 1, 3)), random.uniform(-1, 1, 3))
    Q = transform_points(T, P) + random.normal(scale=0.002, size=P.shape)
    gate = np.ones((2, 3))
    found, score = find_best_hypothesis(P.T.copy(), Q.T.copy(), gate, 200, np.uint32(seed))
    sides = P - np.roll(P, 1, axis=0)
    is_triangle = np.linalg.norm(sides, axis=1).min() > 0.05
    assert (score > 0) == is_triangle
    if is_triangle:
        assert found == pytest.approx(fit_rigid_motion(P, Q, np.ones(3)), abs=1e-9)


def test_seeds_choose_other_pairs() -> None:
    pairs = make_noisy_pairs(0, 100, 20)
    found = {find_consensus(pairs, 500, seed).T_reference_camera.tobytes() for seed in range(10)}
    assert len(found) > 5


@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_pairs_give_no_consensus(n: int) -> None:
    P = sample_points(np.random.default_rng(0), n)
    T, inliers = consensus_of(P, P)
    assert (inliers, T.tolist()) == (0, np.eye(4).tolist())


def test_three_pairs_are_enough() -> None:
    P = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.2], [0.0, 0.4, 1.4]])
    T, inliers = consensus_of(P, transform_points(T_REFERENCE_CAMERA, P))
    assert inliers == 3
    np.testing.assert_allclose(T, T_REFERENCE_CAMERA, atol=1e-9)


LINE = np.column_stack([np.linspace(-1, 1, 30), np.zeros(30), np.full(30, 1.5)])

SAME = np.tile([0.1, 0.2, 1.5], (30, 1))

CLUMP = np.random.default_rng(0).normal((0.0, 0.0, 1.0), 0.004, (30, 3))


@pytest.mark.parametrize("P", [LINE, SAME, CLUMP], ids=["line", "same", "clump"])
@pytest.mark.parametrize("shift_m", [0.0, 0.1])
def test_degenerate_points_give_no_consensus(P: Array, shift_m: float) -> None:
    # Not even when they stand still, and so agree with the identity.
    T, inliers = consensus_of(P, P + shift_m)
    assert (inliers, T.tolist()) == (0, np.eye(4).tolist())


def test_points_that_moved_non_rigidly_give_hardly_a_consensus() -> None:
    random = np.random.default_rng(0)
    assert consensus_of(sample_points(random, 200), sample_points(random, 200))[1] < 15


def test_a_mirror_image_gives_no_consensus() -> None:
    P = sample_points(np.random.default_rng(0), 100)
    assert consensus_of(P, P * [-1.0, 1.0, 1.0])[1] < 30


@FIRST_CALL_COMPILES
@given(st.lists(st.tuples(*[COORDINATE] * 6), max_size=20))
def test_no_input_raises_and_every_result_is_a_motion(rows: list[tuple[float, ...]]) -> None:
    values = np.array(rows).reshape(-1, 6)
    sigma_m = np.full(len(values), 0.005)
    found = find_consensus(PointPairs(values[:, :3], values[:, 3:], sigma_m, sigma_m), 100, 1)
    assert is_rigid(found.T_reference_camera)


def test_the_gate_follows_the_sensor_noise() -> None:
    P = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    pairs = make_exact_pairs(P, P)
    largest_m = 1.0 / inverse_gate(pairs)
    # Three sigmas of two readings, 0.3 pixels across and 1.4e-3/m of 1/z along, and 2 mm.
    across_m = 0.002 + 3 * np.sqrt(2) * 0.3 / 520 * np.array([1.0, 3.0])
    along_m = 0.002 + 3 * np.sqrt(2) * 0.0014 * np.array([1.0, 9.0])
    assert largest_m == pytest.approx(np.column_stack([across_m, along_m]))


@pytest.mark.parametrize(("axis", "column"), [(0, 0), (1, 0), (2, 1)])
@pytest.mark.parametrize(("share", "score"), [(0.0, 1.0), (0.5, 0.75), (0.9, 0.19), (1.01, 0.0)])
def test_the_score_of_a_pair_falls_to_zero_at_the_gate(
    axis: int, column: int, share: float, score: float
) -> None:
    P = sample_points(np.random.default_rng(0), 40)
    gate = inverse_gate(make_exact_pairs(P, P))
    Q = P.copy()
    Q[0, axis] += share / gate[0, column]
    found, total = find_best_hypothesis(P.T.copy(), Q.T.copy(), gate.T.copy(), 500, np.uint32(1))
    assert total == pytest.approx(39 + score)
    assert found == pytest.approx(np.eye(4), abs=1e-9)


@pytest.mark.parametrize(("axis", "column"), [(0, 0), (1, 0), (2, 1)])
@pytest.mark.parametrize(("share", "agrees"), [(0.99, True), (1.01, False)])
def test_a_pair_agrees_up_to_the_gate(axis: int, column: int, share: float, agrees: bool) -> None:
    P = np.array([[0.1, 0.2, 2.0]])
    gate = inverse_gate(make_exact_pairs(P, P))
    Q = P.copy()
    Q[0, axis] += share / gate[0, column]
    assert find_inliers(np.eye(4), make_exact_pairs(P, Q), gate).tolist() == [agrees]


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
