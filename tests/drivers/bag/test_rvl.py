"""RVL: every depth image survives, and damaged data are refused."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from drivers.bag.rvl import decode_rvl

# With pixels that have no reading in runs, as in real images.
DEPTH = arrays(np.uint16, (6, 8), elements=st.sampled_from([0, 0, 0, 1, 500, 501, 65535]))


def encode_rvl(depth: NDArray[np.uint16]) -> bytes:
    """Encode as the paper describes it, number by number."""
    nibbles: list[int] = []

    def add(number: int) -> None:
        while number > 7:
            nibbles.append(number & 7 | 8)
            number >>= 3
        nibbles.append(number)

    values, previous, i = depth.ravel().tolist(), 0, 0
    while i < len(values):
        absent = next((k for k in range(i, len(values)) if values[k]), len(values)) - i
        begin = i + absent
        end = next((k for k in range(begin, len(values)) if not values[k]), len(values))
        add(absent)
        add(end - begin)
        for value in values[begin:end]:
            add(2 * (value - previous) if value >= previous else 2 * (previous - value) - 1)
            previous = value
        i = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        int("".join(f"{n:x}" for n in nibbles[k : k + 8]), 16) for k in range(0, len(nibbles), 8)
    ]
    return struct.pack(f"<{len(words)}I", *words)


@given(DEPTH)
def test_every_image_survives(depth: NDArray[np.uint16]) -> None:
    np.testing.assert_array_equal(decode_rvl(encode_rvl(depth), *depth.shape), depth)


def test_a_known_image_is_decoded() -> None:
    # Two pixels without a reading, two of 3 and 1 mm: 2, 2, +3 (6), -2 (3), then padding.
    np.testing.assert_array_equal(decode_rvl(b"\x00\x00\x63\x22", 1, 4), [[0, 0, 3, 1]])


@given(st.binary(max_size=40))
def test_other_bytes_are_an_image_or_refused(data: bytes) -> None:
    with suppress(ValueError):
        assert decode_rvl(data, 4, 5).shape == (4, 5)


def test_incomplete_data_are_refused() -> None:
    depth = np.arange(1000, 1400, dtype=np.uint16).reshape(20, 20)
    data = encode_rvl(depth)
    for end in (0, 4, len(data) // 2):
        with pytest.raises(ValueError, match="the data are"):
            decode_rvl(data[:end], 20, 20)
