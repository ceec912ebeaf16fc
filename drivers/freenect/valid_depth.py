"""Which of libfreenect's millimetres are distances that the sensor measured."""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

# libfreenect itself takes this and more for "too far".
MAX_DEPTH_MM = 10_000

MillimetreTable = NDArray[np.uint16]


class DepthFilter(Protocol):
    """Takes out of a depth image what is no reading."""

    def __call__(self, depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(480, 640) uint16 millimetres; 0 = no reading."""
        ...


def find_valid_depths_mm(raw_to_mm: MillimetreTable) -> MillimetreTable:
    """The distances that a device can measure, of its table of millimetres per raw value.

    The formula behind the table has a pole at a raw value of about 1084. From there on the table
    holds what is left of huge and negative numbers in 16 bits: most are over 10 m, some look like
    distances. What only the rising part before the pole holds is a measurement.
    """
    table = raw_to_mm.astype(np.int64)
    ends = np.flatnonzero((table >= MAX_DEPTH_MM) | (np.diff(table, prepend=0) < 0))
    end = int(ends[0]) if ends.size else table.size
    return np.setdiff1d(raw_to_mm[:end], raw_to_mm[end:])


def all_depths_to_10_m() -> MillimetreTable:
    """For a source whose table is not known: every distance under 10 m."""
    return np.arange(1, MAX_DEPTH_MM, dtype=np.uint16)


class ValidDepthMask:
    """Keeps the distances of a list and makes 0 of all others."""

    def __init__(self, valid_mm: MillimetreTable) -> None:
        self._table = np.zeros(1 << 16, dtype=np.uint16)
        self._table[valid_mm] = valid_mm

    def __call__(self, depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """See `DepthFilter`."""
        return cv2.LUT(depth_mm, self._table)  # type: ignore[return-value]
