"""Messages arrive as they were sent, whatever the size and layout of their arrays."""

from dataclasses import dataclass
from multiprocessing import Pipe

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from drivers.core.process.messages import receive_message, send_message


@dataclass(frozen=True, eq=False)
class Positions:
    """A message with an array."""

    positions: NDArray[np.float64]


@given(arrays.arrays(np.float64, st.tuples(st.integers(0, 20), st.just(3))), st.booleans())
def test_arrays_are_restored_and_can_be_written_to(
    positions: NDArray[np.float64], is_reversed: bool
) -> None:
    array = positions[::-1, ::2] if is_reversed else positions
    sender, receiver = Pipe()
    with sender, receiver:
        send_message(sender, Positions(array))
        send_message(sender, "on")
        received = receive_message(receiver)
        assert receive_message(receiver) == "on"
    np.testing.assert_array_equal(received.positions, array)
    received.positions[:] = 0.0
