"""The offset of a stamp from the exposure, estimated from a switched LED."""

import numpy as np
import pytest

from benchmarks.led_timing import exposed_fraction, find_lit_pixels, fit_timing
from drivers.core.geometry import Array

STAMPS_S = 100.0 + np.arange(120) / 30


def switches(seed: int = 0) -> Array:
    """Irregular switching times of the LED."""
    return 100.0 + np.cumsum(np.random.default_rng(seed).uniform(0.2, 0.5, 10))


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [-0.020, 0.0, 0.0333])
def test_the_delay_of_the_exposure_is_estimated_to_a_millisecond(delay_s: float) -> None:
    noise = np.random.default_rng(1).normal(0.0, 2.0, len(STAMPS_S))
    brightness = 40.0 + 90.0 * exposed_fraction(STAMPS_S + delay_s, 0.016, switches()) + noise
    timing = fit_timing(STAMPS_S, brightness, switches())
    assert timing.delay_s == pytest.approx(delay_s, abs=1e-3)
    assert timing.explained_variance > 0.95


@pytest.mark.slow
def test_an_invisible_led_explains_nothing() -> None:
    brightness = np.random.default_rng(2).normal(50.0, 2.0, len(STAMPS_S))
    assert fit_timing(STAMPS_S, brightness, switches()).explained_variance < 0.2


def test_an_exposure_across_a_switch_is_lit_in_part() -> None:
    shares = exposed_fraction(np.array([0.9, 1.0, 1.005, 2.5]), 0.02, np.array([1.0, 2.0]))
    assert shares == pytest.approx([0.0, 0.5, 0.75, 0.0])


def test_the_pixels_that_follow_the_led_are_found() -> None:
    pictures = np.random.default_rng(3).integers(90, 110, (60, 30, 40)).astype(np.uint8)
    is_on = np.arange(60) % 3 == 0
    pictures[is_on, 7, 11] = 250
    rows, columns = np.nonzero(find_lit_pixels(pictures, is_on))
    assert (rows.tolist(), columns.tolist()) == ([7], [11])
