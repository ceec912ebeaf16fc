"""The tables by which one Kinect's raw depth becomes millimeters, registered to color."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 480, 640
RAW_VALUES = 2048
# libfreenect treats this and larger depths as too far.
MAX_DEPTH_MM = 10_000
# Units of the registration's columns; its rows are whole pixels.
REGISTRATION_UNITS_PER_PX = 256

MillimeterTable = NDArray[np.uint16]


@dataclass(frozen=True)
class DepthTables:
    """Tables of one Kinect, as libfreenect computes them.

    Attributes:
        raw_to_mm: (2048,) distance of each raw value; see `find_valid_depths_mm`.
        column_shift: (10000,) int32 shift in the color image of each distance, in the units of the
            registration.
        registration: (480, 640, 2) int32 column, in its units, and row of each pixel in the color
            image, without the shift.
        skipped_pixels: Number of pixels of the color image before the first of a depth image.
    """

    raw_to_mm: MillimeterTable
    column_shift: NDArray[np.int32]
    registration: NDArray[np.int32]
    skipped_pixels: int

    @cached_property
    def valid_mm(self) -> MillimeterTable:
        """(2048,) distance of each raw value; 0 for values that are no reading."""
        is_valid = np.isin(self.raw_to_mm, find_valid_depths_mm(self.raw_to_mm))
        return np.where(is_valid, self.raw_to_mm, np.uint16(0))


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
