"""Decoding of RVL, a lossless compression of depth images.

Wilson, "Fast Lossless Depth Image Compression", ISS 2017. An image is a sequence of runs: the
number of pixels without a reading, the number of readings, and the difference of each of these from
the reading before. A number is a sequence of nibbles with 3 bits each, lowest first; bit 3 says
that another follows. A difference has its sign in the lowest bit. Nibbles fill words of 32 bits
from the top.
"""

import numpy as np
from numpy.typing import NDArray

MAX_NIBBLES = 7  # of a number: more bits than pixels or differences need


def decode_rvl(data: bytes, height: int, width: int) -> NDArray[np.uint16]:
    """Decode a (height, width) image, 0 = no reading.

    Args:
        data: The compressed image, without the header of ROS.

    Raises:
        ValueError: The data are incomplete or damaged.
    """
    numbers = _read_numbers(data)
    differences = (numbers >> 1) ^ -(numbers & 1)
    pixels = height * width
    has_reading = np.zeros(pixels, bool)
    runs = []
    pixel = position = 0
    while pixel < pixels:
        if position + 2 > len(numbers):
            raise ValueError("the data are incomplete")
        absent, readings = numbers[position : position + 2].tolist()
        begin, position = position + 2, position + 2 + readings
        has_reading[pixel + absent : pixel + absent + readings] = True
        pixel += absent + readings
        runs.append(differences[begin:position])
    steps = np.concatenate([np.empty(0, np.int64), *runs])
    if pixel > pixels or len(steps) != np.count_nonzero(has_reading):
        raise ValueError("the data are damaged")
    depth = np.zeros(pixels, np.uint16)
    depth[has_reading] = np.cumsum(steps).astype(np.uint16)
    return depth.reshape(height, width)


def _read_numbers(data: bytes) -> NDArray[np.int64]:
    words = np.frombuffer(data, "<u4", len(data) // 4)
    octets = words.astype(">u4").view(np.uint8)
    nibbles = np.stack([octets >> 4, octets & 15], axis=1).ravel()
    ends = np.flatnonzero(nibbles < 8)
    if not len(ends):
        return np.empty(0, np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    lengths = ends + 1 - starts
    if lengths.max() > MAX_NIBBLES:
        raise ValueError("the data are damaged")
    digits = (nibbles[: ends[-1] + 1] & 7).astype(np.int64)
    places = np.arange(len(digits)) - np.repeat(starts, lengths)
    return np.add.reduceat(digits << 3 * places, starts)
