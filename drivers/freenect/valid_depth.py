"""The filter that separates measured depths from invalid values of libfreenect."""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

# libfreenect treats this and larger depths as too far.
MAX_DEPTH_MM = 10_000

MillimeterTable = NDArray[np.uint16]


class DepthFilter(Protocol):
    """Sets invalid values of a depth image to 0."""

    def __call__(self, depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Filter (480, 640) uint16 millimeters; 0 = no reading."""
        ...


def find_valid_depths_mm(raw_to_mm: MillimeterTable) -> MillimeterTable:
    """Find the distances that a device can measure in its table of millimeters per raw value.

    The formula of the table has a pole at a raw value of about 1084. Beyond it the table holds
    huge and negative numbers truncated to 16 bits: most exceed 10 m, but some look like distances.
    A distance is valid if only the rising part before the pole holds it.
    """
    table = raw_to_mm.astype(np.int64)
    ends = np.flatnonzero((table >= MAX_DEPTH_MM) | (np.diff(table, prepend=0) < 0))
    end = int(ends[0]) if ends.size else table.size
    return np.setdiff1d(raw_to_mm[:end], raw_to_mm[end:])


def all_depths_to_10_m() -> MillimeterTable:
    """Return all distances below 10 m, for a source without a table."""
    return np.arange(1, MAX_DEPTH_MM, dtype=np.uint16)


class ValidDepthMask:
    """Keeps the distances of a list and sets all others to 0."""

    def __init__(self, valid_mm: MillimeterTable) -> None:
        self._table = np.zeros(1 << 16, dtype=np.uint16)
        self._table[valid_mm] = valid_mm

    def __call__(self, depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        return cv2.LUT(depth_mm, self._table)  # type: ignore[return-value]
