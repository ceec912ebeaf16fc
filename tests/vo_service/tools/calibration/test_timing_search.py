"""The search for the minimum of known costs, and its uncertainty."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from vo_service.tools.calibration.timing import validate_minimum
from vo_service.tools.calibration.timing_search import CostFunction, find_minimum

SEGMENTS = 8


def make_costs(*minima_s: tuple[float, float], depth: float = 1.0) -> CostFunction:
    """Make costs that grow with the error of the timing; each segment has its own minimum."""

    def costs(assumed_s: Array, candidates_s: Array) -> Array:
        error = (candidates_s[None] - np.array(minima_s)[:, None]) / 0.010
        cost: Array = np.log1p(depth * (error**2).sum(axis=2) / 2)
        return cost

    return costs


@given(st.floats(0.0, 0.035), st.floats(-0.030, 0.030))
def test_the_minimum_is_found_anywhere(readout_s: float, offset_s: float) -> None:
    costs = make_costs(*[(readout_s, offset_s)] * SEGMENTS)
    minimum = find_minimum(costs, costs)
    np.testing.assert_allclose(minimum.timing_s, [readout_s, offset_s], atol=1e-3)
    np.testing.assert_allclose(minimum.sigma_s, 0.0, atol=1e-9)


def test_contradicting_segments_increase_the_uncertainty() -> None:
    random = np.random.default_rng(3)
    for scatter_s in (0.001, 0.004):
        minima = [(0.02 + r, s) for r, s in random.normal(0.0, scatter_s, (SEGMENTS, 2))]
        minimum = find_minimum(make_costs(*minima), make_costs(*minima))
        expected = scatter_s / np.sqrt(SEGMENTS)
        assert np.all((0.4 * expected < minimum.sigma_s) & (minimum.sigma_s < 2.5 * expected))


def test_segments_with_a_lost_camera_are_left_out() -> None:
    minima = [(0.012, 0.004)] * 3 + [(np.nan, np.nan)] * 2
    minimum = find_minimum(make_costs(*minima), make_costs(*minima))
    assert minimum.segment_count == 3
    np.testing.assert_allclose(minimum.timing_s, [0.012, 0.004], atol=1e-3)


def test_an_always_lost_camera_is_rejected() -> None:
    lost = make_costs(*[(np.nan, np.nan)] * SEGMENTS)
    with pytest.raises(UserFacingError, match="could not be tracked"):
        find_minimum(lost, lost)


def test_costs_without_a_minimum_are_rejected() -> None:
    def downhill(assumed_s: Array, candidates_s: Array) -> Array:
        return np.tile(-candidates_s.sum(axis=1), (SEGMENTS, 1))

    with pytest.raises(UserFacingError, match="no timing explains the images"):
        find_minimum(downhill, downhill)


def test_one_segment_is_too_uncertain() -> None:
    costs = make_costs((0.02, 0.0))
    with pytest.raises(UserFacingError, match="too slowly or too little"):
        validate_minimum(find_minimum(costs, costs))


def test_noisy_costs_of_slow_motion_are_rejected() -> None:
    random = np.random.default_rng(1)
    noise = random.normal(0.0, 1e-3, (SEGMENTS, 9))
    slow = make_costs(*[(0.02, 0.0)] * SEGMENTS, depth=1e-3)
    with pytest.raises(UserFacingError, match="nothing is saved"):
        validate_minimum(
            find_minimum(
                slow, lambda assumed_s, candidates_s: slow(assumed_s, candidates_s) + noise
            )
        )


def test_a_small_negative_readout_is_zero_and_a_large_one_is_rejected() -> None:
    small, large = make_costs(*[(-0.001, 0.0)] * SEGMENTS), make_costs(*[(-0.012, 0.0)] * SEGMENTS)
    assert validate_minimum(find_minimum(small, small)).timing.readout_s == 0.0
    with pytest.raises(UserFacingError, match="from bottom to top, in 12 ms"):
        validate_minimum(find_minimum(large, large))
