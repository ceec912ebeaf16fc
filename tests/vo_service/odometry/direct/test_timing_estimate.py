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


def add_views(estimator: TimingEstimator, count: int, best: Array, views_each: int = 4) -> None:
    for view in range(count):
        estimator.add(float(view // views_each), 0.5, INFORMATION, INFORMATION @ best)


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
    estimator.add(9.0, 0.5, INFORMATION, INFORMATION @ (TRUE + 0.5))
    assert np.abs(estimator.estimate - before).max() < 0.005


@pytest.mark.parametrize("best", [np.array([0.030, 0.0]), np.array([0.0, -0.015])])
def test_a_narrow_prior_that_is_wrong_is_contradicted(best: Array) -> None:
    estimator = estimator_of(NARROW)
    add_views(estimator, 40, best)
    assert (np.abs(estimator.in_use) < 0.3 * np.abs(best) + 1e-9).all()
    by_frames = estimator.contradiction()
    assert by_frames is not None
    np.testing.assert_allclose(by_frames, best, atol=1e-6)


def test_a_narrow_prior_that_is_right_is_not_contradicted() -> None:
    estimator = estimator_of(NARROW)
    add_views(estimator, 40, np.array([0.001, 0.0005]))
    assert estimator.contradiction() is None
