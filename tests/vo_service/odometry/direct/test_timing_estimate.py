"""The timing's estimate from the normal equations of views."""

import numpy as np
import pytest

from drivers.core.geometry import Array
from vo_service.odometry.direct.parameters import KEYFRAME_TIMING_SIGMAS_S, MIN_TIMING_VIEWS
from vo_service.odometry.direct.timing_estimate import TimingEstimator

ZERO = np.zeros(2)
TRUE = np.array([0.020, 0.008])
# Information of a view that measures both to 1 ms.
INFORMATION = np.eye(2) / 0.001**2
NARROW, WIDE = np.array([0.0005, 0.0005]), np.array([0.03, 0.01])


def view_of(best: Array, A: Array = INFORMATION) -> Array:
    return np.column_stack([A, A @ best])


def add_views(estimator: TimingEstimator, count: int, best: Array, views_each: int = 4) -> None:
    for view in range(count):
        estimator.add(float(view // views_each), 0.5, view_of(best))


def estimator_of(sigmas_s: Array) -> TimingEstimator:
    return TimingEstimator(ZERO, sigmas_s, ZERO, ZERO)


def test_views_that_agree_are_believed() -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, 40, TRUE)
    np.testing.assert_allclose(estimator.estimate, TRUE, atol=0.001)
    np.testing.assert_allclose(estimator.in_use, TRUE, atol=0.001)


def test_a_few_views_are_not_used() -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, MIN_TIMING_VIEWS - 1, TRUE)
    assert not estimator.is_certain
    assert (estimator.in_use == ZERO).all()


def test_the_views_of_one_keyframe_share_an_error() -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, 1000, TRUE, views_each=1000)
    assert (estimator.sigmas_s > 0.9 * np.array(KEYFRAME_TIMING_SIGMAS_S)).all()


def test_values_close_to_zero_are_exactly_zero() -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, 40, np.array([0.001, -0.0005]))
    assert (estimator.in_use == ZERO).all()


def test_a_readout_is_never_negative() -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, 40, np.array([-0.005, 0.008]))
    assert estimator.in_use[0] == 0.0


def test_a_single_wrong_view_changes_little() -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, 20, TRUE)
    before = estimator.estimate
    estimator.add(9.0, 0.5, view_of(TRUE + 0.5))
    assert np.abs(estimator.estimate - before).max() < 0.005


@pytest.mark.parametrize("best", [np.array([0.030, 0.0]), np.array([0.0, -0.015])])
def test_a_narrow_prior_that_is_wrong_is_contradicted_and_forgotten(best: Array) -> None:
    estimator = estimator_of(NARROW)
    add_views(estimator, 40, best)
    np.testing.assert_allclose(estimator.in_use, best, atol=0.002)
    by_frames = estimator.contradiction
    assert by_frames is not None
    np.testing.assert_allclose(by_frames, best, atol=1e-6)


def test_a_narrow_prior_that_is_right_is_not_contradicted() -> None:
    estimator = estimator_of(NARROW)
    add_views(estimator, 40, np.array([0.001, 0.0005]))
    assert estimator.contradiction is None


@pytest.mark.parametrize("change", [np.array([0.016, 0.0]), np.array([0.0, -0.008])])
def test_a_change_of_the_timing_is_learned_within_a_few_keyframes(change: Array) -> None:
    estimator = estimator_of(WIDE)
    add_views(estimator, 400, TRUE)
    for keyframe in range(8):
        for _ in range(10):
            estimator.add(1000.0 + keyframe, 0.5, view_of(TRUE + change))
    np.testing.assert_allclose(estimator.in_use, TRUE + change, atol=0.002)


@pytest.mark.parametrize(("keyframes", "certainty"), [(1, 1.0), (4, 0.005)])
def test_one_keyframe_or_uncertain_ones_are_no_change(keyframes: int, certainty: float) -> None:
    estimator, wrong = estimator_of(WIDE), TRUE + np.array([0.040, 0.030])
    add_views(estimator, 400, TRUE)
    for keyframe in range(keyframes):
        for _ in range(10):
            A = certainty * INFORMATION
            estimator.add(1000.0 + keyframe, 0.5, view_of(wrong, A))
    add_views(estimator, 4, TRUE)
    np.testing.assert_allclose(estimator.in_use, TRUE, atol=0.003)


def test_keyframes_that_scatter_by_their_shared_error_are_no_change() -> None:
    estimator, random = estimator_of(WIDE), np.random.default_rng(0)
    for keyframe in range(200):
        best = TRUE + random.normal(0.0, KEYFRAME_TIMING_SIGMAS_S)
        for _ in range(6):
            estimator.add(float(keyframe), 0.5, view_of(best))
    assert (estimator.sigmas_s < 0.2 * np.array(KEYFRAME_TIMING_SIGMAS_S)).all()
    np.testing.assert_allclose(estimator.in_use, TRUE, atol=0.002)


def test_views_without_information_give_no_estimate() -> None:
    estimator = estimator_of(WIDE)
    for view in range(40):
        estimator.add(float(view // 4), 0.5, np.zeros((2, 3)))
    np.testing.assert_allclose(estimator.sigmas_s, WIDE, rtol=1e-6)
    assert (estimator.in_use == ZERO).all()
