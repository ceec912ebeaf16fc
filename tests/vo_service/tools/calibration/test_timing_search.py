"""The search for the least cost, on costs that are known: where it ends, and how sure it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from vo_service.tools.calibration.timing import validate_minimum
from vo_service.tools.calibration.timing_search import CostFunction, find_minimum

PIECES = 8


def costs_of(*minima_s: tuple[float, float], depth: float = 1.0) -> CostFunction:
    """As of a film: the spread of brightness, with its noise, grows with how wrong the timing is.

    Each piece has its own minimum.
    """

    def costs(known_s: Array, tried_s: Array) -> Array:
        off = (tried_s[None] - np.array(minima_s)[:, None]) / 0.010
        grown: Array = np.log1p(depth * (off**2).sum(axis=2) / 2)
        return grown

    return costs


@given(st.floats(0.0, 0.035), st.floats(-0.030, 0.030))
def test_the_minimum_is_found_wherever_it_is(readout_s: float, offset_s: float) -> None:
    costs = costs_of(*[(readout_s, offset_s)] * PIECES)
    found = find_minimum(costs, costs)
    np.testing.assert_allclose(found.timing_s, [readout_s, offset_s], atol=1e-3)
    np.testing.assert_allclose(found.sigma_s, 0.0, atol=1e-9)


def test_pieces_that_contradict_one_another_make_it_less_sure() -> None:
    random = np.random.default_rng(3)
    for scatter_s in (0.001, 0.004):
        minima = [(0.02 + r, s) for r, s in random.normal(0.0, scatter_s, (PIECES, 2))]
        found = find_minimum(costs_of(*minima), costs_of(*minima))
        expected = scatter_s / np.sqrt(PIECES)
        assert np.all((0.4 * expected < found.sigma_s) & (found.sigma_s < 2.5 * expected))


def test_pieces_in_which_the_camera_was_lost_are_left_out() -> None:
    minima = [(0.012, 0.004)] * 3 + [(np.nan, np.nan)] * 2
    found = find_minimum(costs_of(*minima), costs_of(*minima))
    assert found.segment_count == 3
    np.testing.assert_allclose(found.timing_s, [0.012, 0.004], atol=1e-3)


def test_a_film_in_which_it_was_always_lost_is_refused() -> None:
    lost = costs_of(*[(np.nan, np.nan)] * PIECES)
    with pytest.raises(UserFacingError, match="could not be followed"):
        find_minimum(lost, lost)


def test_costs_that_fall_for_ever_are_refused() -> None:
    def downhill(known_s: Array, tried_s: Array) -> Array:
        return np.tile(-tried_s.sum(axis=1), (PIECES, 1))

    with pytest.raises(UserFacingError, match="no timing explains the images"):
        find_minimum(downhill, downhill)


def test_one_piece_alone_is_never_sure_enough() -> None:
    one = costs_of((0.02, 0.0))
    with pytest.raises(UserFacingError, match="too slowly or too little"):
        validate_minimum(find_minimum(one, one))


def test_a_slow_film_whose_pieces_say_anything_is_refused() -> None:
    random = np.random.default_rng(1)
    noise = random.normal(0.0, 1e-3, (PIECES, 9))
    slow = costs_of(*[(0.02, 0.0)] * PIECES, depth=1e-3)
    with pytest.raises(UserFacingError, match="nothing is saved"):
        validate_minimum(
            find_minimum(slow, lambda known_s, tried_s: slow(known_s, tried_s) + noise)
        )


def test_a_readout_a_little_below_zero_is_zero_and_far_below_is_told() -> None:
    little, far = costs_of(*[(-0.001, 0.0)] * PIECES), costs_of(*[(-0.012, 0.0)] * PIECES)
    assert validate_minimum(find_minimum(little, little)).timing.readout_s == 0.0
    with pytest.raises(UserFacingError, match="from bottom to top, in 12 ms"):
        validate_minimum(find_minimum(far, far))
