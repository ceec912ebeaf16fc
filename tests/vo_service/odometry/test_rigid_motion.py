import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.core.geometry import (
    Array,
    fit_rigid_motion,
    inverse,
    is_rigid,
    rigid_transform,
    so3_exp,
    transform_points,
)
from vo_service.odometry.ransac import motion_covariance

SEED = st.integers(0, 2**32 - 1)
VECTOR = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def cloud(seed: int, n: int) -> Array:
    return np.random.default_rng(seed).normal((0.0, 0.0, 2.5), size=(n, 3))


@given(SEED, st.integers(3, 60), VECTOR, VECTOR)
def test_an_exact_motion_is_recovered(
    seed: int, n: int, turn: tuple[float, ...], shift: tuple[float, ...]
) -> None:
    P, w = cloud(seed, n), np.random.default_rng(seed).uniform(0.1, 5.0, n)
    T = rigid_transform(so3_exp(turn), shift)
    assert fit_rigid_motion(P, transform_points(T, P), w) == pytest.approx(T, abs=1e-5)


@given(SEED, st.integers(4, 60))
def test_the_rotation_is_that_of_an_independent_solver(seed: int, n: int) -> None:
    random = np.random.default_rng(seed)
    P, w = cloud(seed, n), random.uniform(0.1, 5.0, n)
    Q = transform_points(rigid_transform(Rotation.random(rng=random).as_matrix(), [1, 2, 3]), P)
    Q += random.normal(scale=0.02, size=Q.shape)
    p_mean, q_mean = np.average(P, axis=0, weights=w), np.average(Q, axis=0, weights=w)
    expected = Rotation.align_vectors(Q - q_mean, P - p_mean, weights=w)[0].as_matrix()
    T = fit_rigid_motion(P, Q, w)
    assert T[:3, :3] == pytest.approx(expected, abs=1e-6)
    assert transform_points(T, p_mean) == pytest.approx(q_mean)


@given(SEED, st.integers(3, 30))
def test_a_mirror_image_is_fitted_by_a_rotation(seed: int, n: int) -> None:
    P = cloud(seed, n)
    assert is_rigid(fit_rigid_motion(P, P * [-1.0, 1.0, 1.0], np.ones(n)))


def test_points_on_a_plane_are_not_mirrored() -> None:
    P = cloud(0, 20) * [1.0, 1.0, 0.0]
    T = rigid_transform(so3_exp([0.4, -1.0, 2.0]), [1.0, 2.0, 3.0])
    assert fit_rigid_motion(P, transform_points(T, P), np.ones(20)) == pytest.approx(T)


def test_a_point_without_weight_does_not_count() -> None:
    P = cloud(0, 10)
    Q, w = P + np.array([0.5, 0.0, 0.0]), np.ones(10)
    Q[3], w[3] = 100.0, 0.0
    expected = rigid_transform(np.eye(3), [0.5, 0.0, 0.0])
    assert fit_rigid_motion(P, Q, w) == pytest.approx(expected)


def errors_of_fits(P: Array, sigma_m: Array, w: Array, T: Array, trials: int) -> Array:
    """(trials, 6) twists xi with T = T_fit exp(xi); noise sigma_m (N, 3) in the axes of P."""
    random = np.random.default_rng(0)
    errors = np.empty((trials, 6))
    for trial in range(trials):
        noisy = P + sigma_m * random.normal(size=P.shape)
        fitted = fit_rigid_motion(P, transform_points(T, noisy), w)
        difference = inverse(fitted) @ T
        errors[trial, :3] = difference[:3, 3]
        errors[trial, 3:] = Rotation.from_matrix(difference[:3, :3]).as_rotvec()
    return errors


@pytest.mark.parametrize("even", [True, False])
def test_the_covariance_is_that_of_many_noisy_fits(even: bool) -> None:
    P = cloud(3, 60) + np.array([0.3, -0.2, 1.5])
    # Noise as a depth camera has it: along the ray it grows with the square of the distance.
    z = P[:, 2]
    sigma_m = np.column_stack([0.002 * z, 0.002 * z, 0.004 * z**2])
    w = np.full(len(P), 1e4) if even else 1.0 / (sigma_m**2).sum(axis=1)
    T = rigid_transform(so3_exp([0.9, -0.5, 0.3]), [0.2, 0.1, -0.4])
    sample = np.cov(errors_of_fits(P, sigma_m, w, T, 2000).T)
    predicted = motion_covariance(P, w, sigma_m)
    scale = np.sqrt(np.outer(np.diag(sample), np.diag(sample)))
    assert np.abs((predicted - sample) / scale).max() < 0.12


def test_the_covariance_is_symmetric_and_positive() -> None:
    P = cloud(3, 20)
    covariance = motion_covariance(P, np.full(20, 1e4), np.full((20, 3), 0.01))
    assert np.array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_points_on_a_line_leave_the_rotation_about_it_unconstrained() -> None:
    P = np.outer(np.linspace(-1.0, 1.0, 20), [1.0, 0.0, 0.0])
    covariance = motion_covariance(P, np.full(20, 1e4), np.full((20, 3), 0.01))
    assert np.sqrt(covariance[3, 3]) == pytest.approx(1.0)
    assert np.sqrt(np.delete(np.diag(covariance), 3)).max() < 0.01
