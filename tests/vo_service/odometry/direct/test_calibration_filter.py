"""The calibration's estimate from the information of views."""

import numpy as np
import pytest

from drivers.core.geometry import Array
from vo_service.odometry.direct.calibration import CalibrationFilter
from vo_service.odometry.direct.calibration_equations import FOCAL, TIMING
from vo_service.odometry.direct.parameters import (
    FOCAL_PRIOR_SIGMA,
    INITIAL_VIEW_ERROR,
    KEYFRAME_CALIBRATION_SIGMAS,
)

TRUE = np.array([0.020, 0.008])
WIDE, NARROW = (0.03, 0.01), (0.0005, 0.0005)
# Information of a view that measures the timing to 1 ms and both focal lengths to 0.3 %.
INFORMATION = INITIAL_VIEW_ERROR * np.diag(np.array([0.001, 0.001, 0.003, 0.003]) ** -2.0)


def view_of(
    timing: Array, focal: float = 0.0, disagreement: float = 0.0, A: Array = INFORMATION
) -> Array:
    return np.column_stack([A, A @ [*timing, focal, disagreement]])


def misfit(calibration: Array, best: Array) -> float:
    """Negative log-likelihood of frames that fit best with a calibration (3,)."""
    return float(np.abs((calibration - best) / [0.005, 0.002, 0.01]).sum())


def add(
    learned: CalibrationFilter,
    count: int,
    view: Array,
    first_keyframe: float = 0.0,
    best: Array | None = None,
) -> None:
    """Add the same view several times, four for each keyframe; frames fit best with it too."""
    fitting = np.asarray(np.linalg.lstsq(view[:, :4], view[:, 4])[0][:3] if best is None else best)
    for k in range(count):
        learned.add(first_keyframe + k // 4, view)
        if k % 4 == 3:
            learned.compare(lambda calibration: misfit(calibration, fitting))


def filter_of(sigmas_s: tuple[float, float], focal: float = 0.0) -> CalibrationFilter:
    sigmas = np.array([*sigmas_s, FOCAL_PRIOR_SIGMA])
    unlearned = np.array([0.0, 0.0, focal])
    return CalibrationFilter(unlearned, sigmas, unlearned)


def learn(view: Array, count: int = 80, best: Array | None = None) -> Array:
    learned = filter_of(WIDE)
    add(learned, count, view, best=best)
    return learned.in_use


def test_a_timing_that_fits_no_better_is_refused_until_it_does() -> None:
    learned = filter_of(WIDE)
    add(learned, 80, view_of(TRUE), best=np.zeros(3))
    assert (learned.in_use == 0.0).all()
    assert learned.timing_trial.is_refused
    add(learned, 40, view_of(TRUE), first_keyframe=100.0)
    np.testing.assert_allclose(learned.in_use[TIMING], TRUE, atol=0.001)
    assert not learned.timing_trial.is_refused


def test_a_value_that_is_refused_counts_with_its_distance_from_the_best_estimate() -> None:
    learned = filter_of(WIDE)
    np.testing.assert_array_equal(learned.errors, learned.sigmas)
    add(learned, 80, view_of(TRUE), best=np.zeros(3))
    assert (learned.errors[TIMING] > 0.9 * TRUE).all()
    assert (learned.sigmas[TIMING] < 0.3 * TRUE).all()


def test_a_focal_length_that_no_longer_fits_better_is_taken_back() -> None:
    learned = filter_of(NARROW)
    add(learned, 160, view_of(np.zeros(2), 0.03))
    assert learned.in_use[FOCAL] > 0.02
    add(learned, 40, view_of(np.zeros(2), 0.03), first_keyframe=100.0, best=np.zeros(3))
    assert (learned.in_use[FOCAL], learned.is_focal_learned) == (0.0, False)
    assert learned.focal_trial.is_refused


def test_a_timing_that_was_found_by_the_fit_of_frames_is_used_at_once() -> None:
    sigmas = np.array([0.006, 0.004, 0.02])
    learned = CalibrationFilter(np.append(TRUE, 0.0), sigmas, np.zeros(3))
    assert learned.timing_trial.is_accepted
    for keyframe in range(3):
        learned.add(keyframe, view_of(TRUE + 0.006))
    assert (learned.in_use[TIMING] > TRUE).all()


def test_views_that_agree_are_believed() -> None:
    np.testing.assert_allclose(learn(view_of(TRUE, 0.03)), [*TRUE, 0.03], atol=0.007)
    np.testing.assert_allclose(learn(view_of(TRUE, 0.03))[TIMING], TRUE, atol=0.001)


def test_the_views_of_one_keyframe_share_an_error() -> None:
    learned = filter_of(WIDE)
    for _ in range(1000):
        learned.add(0.0, view_of(TRUE))
    assert (learned.sigmas[TIMING] > 0.9 * np.array(KEYFRAME_CALIBRATION_SIGMAS[:2])).all()


def test_a_readout_is_never_negative() -> None:
    assert learn(view_of(np.array([-0.005, 0.008])))[0] == 0.0


def test_a_readout_that_is_coupled_with_the_focal_length_waits_for_it() -> None:
    """Views that measure only the sum of 20 ms of readout and 1.3 % of focal length."""
    direction = np.array([1.0 / 0.020, 0.0, 1.0 / 0.013, 0.0])
    A = 1e6 * np.outer(direction, direction) + np.diag([0.0, 1e8, 0.0, 1e6])
    learned = filter_of(WIDE)
    add(learned, 200, view_of(TRUE, A=A))
    assert not learned.is_certain


@pytest.mark.parametrize("best", [np.array([0.030, 0.0]), np.array([0.0, -0.015])])
def test_a_narrow_prior_that_is_wrong_is_contradicted_and_forgotten(best: Array) -> None:
    learned = filter_of(NARROW)
    add(learned, 40, view_of(best))
    np.testing.assert_allclose(learned.in_use[TIMING], best, atol=0.002)
    assert learned.contradiction is not None
    np.testing.assert_allclose(learned.contradiction, best, atol=1e-6)


def test_a_narrow_prior_that_is_right_is_not_contradicted() -> None:
    learned = filter_of(NARROW)
    add(learned, 40, view_of(np.array([0.001, 0.0005])))
    assert learned.contradiction is None


@pytest.mark.parametrize("change", [np.array([0.016, 0.0]), np.array([0.0, -0.008])])
def test_a_change_of_the_timing_is_learned_within_a_few_keyframes(change: Array) -> None:
    learned = filter_of(WIDE)
    add(learned, 400, view_of(TRUE))
    add(learned, 32, view_of(TRUE + change), first_keyframe=1000.0)
    np.testing.assert_allclose(learned.in_use[TIMING], TRUE + change, atol=0.002)


@pytest.mark.parametrize(("count", "certainty"), [(4, 1.0), (16, 1e-6)])
def test_one_keyframe_or_uncertain_ones_are_no_change(count: int, certainty: float) -> None:
    learned, wrong = filter_of(WIDE), TRUE + np.array([0.040, 0.030])
    add(learned, 400, view_of(TRUE))
    add(learned, count, view_of(wrong, A=certainty * INFORMATION), first_keyframe=1000.0)
    add(learned, 4, view_of(TRUE), first_keyframe=2000.0)
    np.testing.assert_allclose(learned.in_use[TIMING], TRUE, atol=0.003)


def test_keyframes_that_scatter_by_their_shared_error_are_no_change() -> None:
    learned, random = filter_of(WIDE), np.random.default_rng(0)
    sigmas_s = np.array(KEYFRAME_CALIBRATION_SIGMAS[:2])
    for keyframe in range(200):
        add(learned, 4, view_of(TRUE + random.normal(0.0, sigmas_s)), float(keyframe))
    assert (learned.sigmas[TIMING] < 0.2 * sigmas_s).all()
    np.testing.assert_allclose(learned.in_use[TIMING], TRUE, atol=0.002)


def test_views_without_information_change_nothing() -> None:
    learned = filter_of(WIDE)
    add(learned, 100, 0.0 * view_of(TRUE))
    np.testing.assert_allclose(learned.sigmas, [*WIDE, FOCAL_PRIOR_SIGMA], rtol=1e-6)
    assert (learned.in_use == 0.0).all()
    assert learned.disagreement is None


def test_a_right_focal_length_stays_exactly_unchanged() -> None:
    learned = filter_of(NARROW)
    add(learned, 160, view_of(np.zeros(2), 0.002, -0.004))
    assert (learned.in_use[FOCAL], learned.is_focal_learned) == (0.0, False)


def test_the_views_of_two_keyframes_are_not_enough_for_a_focal_length() -> None:
    learned = filter_of(NARROW)
    add(learned, 8, view_of(np.zeros(2), 0.03))
    assert learned.in_use[FOCAL] == 0.0
    assert learned.disagreement is None


def test_depth_that_disagrees_with_brightness_gives_no_focal_length() -> None:
    learned = filter_of(NARROW)
    add(learned, 160, view_of(np.zeros(2), 0.0, -0.051))
    assert learned.in_use[FOCAL] == 0.0
    assert learned.disagreement == pytest.approx(-0.051, abs=0.002)


def test_a_remembered_focal_length_is_used_until_another_is_learned() -> None:
    learned = filter_of(NARROW, 0.03)
    add(learned, 160, view_of(np.zeros(2), 0.031))
    assert (learned.in_use[FOCAL], learned.is_focal_learned) == (0.03, False)
    add(learned, 480, view_of(np.zeros(2), -0.01), first_keyframe=1000.0)
    assert learned.in_use[FOCAL] < 0.01
    assert learned.is_focal_learned


def test_views_that_scatter_more_count_less() -> None:
    random, sigmas = np.random.default_rng(0), []
    for scatter_s in (0.0, 0.05):
        learned = filter_of(WIDE)
        for keyframe in range(20):
            scattered = TRUE + random.normal(0.0, scatter_s, 2)
            add(learned, 4, view_of(scattered, A=1e-3 * INFORMATION), float(keyframe))
        sigmas.append(learned.sigmas[0])
    assert sigmas[1] > 2.0 * sigmas[0]
