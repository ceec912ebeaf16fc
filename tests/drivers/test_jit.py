"""Compiling numeric kernels so that it can be interrupted."""

import numba
import pytest

from drivers.jit import interruptible


def stop() -> None:
    raise KeyboardInterrupt


def test_a_kernel_is_not_compiled_any_more_once_the_check_raises() -> None:
    double = numba.njit(lambda x: 2 * x)
    with pytest.raises(KeyboardInterrupt), interruptible(stop):
        double(1)
    assert double.signatures == []
    assert double(1) == 2


def test_a_kernel_that_is_compiled_already_is_not_checked() -> None:
    double = numba.njit(lambda x: 2 * x)
    double(1)
    with interruptible(stop):
        assert double(2) == 4
