"""The focal length's estimate from the information of views."""

import numpy as np

from vo_service.odometry.direct.online_focal import FocalEstimator
from vo_service.odometry.direct.parameters import FOCAL_PRIOR_SIGMA, FOCAL_STEP_RATIO

# Information of a view that measures the focal length to 0.3 %.
INFORMATION = FOCAL_STEP_RATIO / 0.003**2


def add_views(
    estimator: FocalEstimator, by_brightness: float, by_depth: float, keyframes: int = 20
) -> None:
    """Add views that ask for these focal lengths, whatever is in use."""
    for view in range(8 * keyframes):
        change = np.array([by_brightness, by_depth]) - estimator.in_use
        information = np.array([INFORMATION, INFORMATION])
        product = FOCAL_STEP_RATIO * information * change
        estimator.add(float(view // 8), np.column_stack([information, product]))


def test_a_wrong_focal_length_is_corrected_if_brightness_and_depth_agree() -> None:
    estimator = FocalEstimator()
    add_views(estimator, 0.03, 0.03)
    assert abs(estimator.in_use - 0.03) < 0.007
    assert estimator.source == "learned"
    assert estimator.sigma < 0.5 * FOCAL_PRIOR_SIGMA


def test_a_right_focal_length_stays_exactly_unchanged() -> None:
    estimator = FocalEstimator()
    add_views(estimator, 0.002, -0.002)
    assert (estimator.in_use, estimator.source) == (0.0, "intrinsics")


def test_the_views_of_two_keyframes_are_not_enough() -> None:
    estimator = FocalEstimator()
    add_views(estimator, 0.03, 0.03, keyframes=2)
    assert estimator.in_use == 0.0
    assert estimator.disagreement is None


def test_brightness_is_not_believed_where_depth_disagrees_more() -> None:
    estimator = FocalEstimator()
    add_views(estimator, 0.018, -0.033)
    assert estimator.in_use == 0.0
    assert estimator.disagreement is not None
    assert abs(estimator.disagreement[0] + 0.051) < 1e-6


def test_brightness_is_believed_where_it_is_clearly_further_away() -> None:
    estimator = FocalEstimator()
    add_views(estimator, 0.04, -0.01)
    assert abs(estimator.in_use - 0.04) < 0.01


def test_views_without_information_change_nothing() -> None:
    estimator = FocalEstimator()
    for view in range(100):
        assert not estimator.add(float(view), np.zeros((2, 2)))
    assert (estimator.in_use, estimator.sigma) == (0.0, FOCAL_PRIOR_SIGMA)
    assert estimator.disagreement is None


def test_a_remembered_focal_length_is_used_until_another_is_learned() -> None:
    estimator = FocalEstimator(0.03, 0.01, "memory")
    add_views(estimator, 0.031, 0.031)
    assert (estimator.in_use, estimator.source) == (0.03, "memory")
    add_views(estimator, -0.01, -0.01, keyframes=60)
    assert estimator.in_use < 0.01
    assert estimator.source == "learned"
