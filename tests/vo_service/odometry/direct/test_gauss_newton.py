import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.geometry import Array
from vo_service.odometry.direct.gauss_newton import (
    MotionPrior,
    add_motion_prior,
    prior_information,
)

FEW = settings(max_examples=30)
MOTIONS = arrays(np.float64, 9, elements=st.floats(-1.0, 1.0, allow_subnormal=False))


@FEW
@given(MOTIONS, st.floats(1.0, 60.0), st.integers(0, 1000))
def test_the_prior_is_the_squared_difference_of_motion_and_prediction(
    off: Array, rate_hz: float, seed: int
) -> None:
    """Its value is sum P (off + e - rate d)^2 for a step d of the pose and e of the motion.

    The acceleration is coupled only with itself.
    """
    random = np.random.default_rng(seed)
    information, step = random.uniform(1.0, 100.0, 9), random.normal(size=15)
    H, g = np.zeros((15, 15)), np.zeros(15)
    prior = MotionPrior(np.eye(4), rate_hz, np.zeros(9), information)
    add_motion_prior(H, g, off, np.zeros(9), prior_information(prior))
    value = step @ H @ step + 2 * g @ step + information @ off**2
    apart = off + step[6:]
    apart[:6] -= rate_hz * step[:6]
    assert value == pytest.approx(information @ apart**2, rel=1e-6)
    np.testing.assert_array_equal(H, H.T)
