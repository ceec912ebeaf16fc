"""Depth images from the packed 11-bit values of the Kinect, with the values of libfreenect."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel
from drivers.freenect.depth_tables import (
    COLUMNS,
    MAX_DEPTH_MM,
    RAW_VALUES,
    REGISTRATION_UNITS_PER_PX,
    ROWS,
    DepthTables,
)

# While depth is registered, the image has a margin of its own width on both sides: so a pixel that
# leaves the image needs no test. One more row takes the pixels that have no place in the image.
_LEFT = COLUMNS
_PADDED_COLUMNS = 2048
_EMPTY = 0xFFFF


class UnregisteredDepth:
    """Converts depth as the depth camera sees it."""

    def __init__(self, tables: DepthTables) -> None:
        self._valid_mm = tables.valid_mm

    def __call__(self, packed: NDArray[np.uint8], depth_mm: NDArray[np.uint16]) -> None:
        """Convert (422400,) packed values to (480, 640) millimeters; 0 = no reading."""
        _look_up(packed, self._valid_mm, depth_mm.reshape(-1))


class RegisteredDepth:
    """Converts depth to what the color camera sees; of several readings of a pixel the nearest.

    A reading that is not valid hides those behind it, as in libfreenect. So its code, which is
    twice the distance, has the lowest bit set.
    """

    def __init__(self, tables: DepthTables) -> None:
        mm = tables.raw_to_mm.astype(np.int64)
        is_reading = (mm > 0) & (mm < MAX_DEPTH_MM)
        shift = tables.column_shift[np.where(is_reading, mm, 0)].astype(np.int64)
        is_reading &= np.abs(shift) < COLUMNS * REGISTRATION_UNITS_PER_PX
        code = np.where(is_reading, 2 * mm + (tables.valid_mm == 0), _EMPTY)
        self._entries = np.where(is_reading, shift, 0) << 16 | code
        column, row = tables.registration.reshape(-1, 2).astype(np.int64).T
        is_inside = (column >= 0) & (column < COLUMNS * REGISTRATION_UNITS_PER_PX)
        is_inside &= (row >= 0) & (row < ROWS)
        first = np.where(is_inside, row, ROWS) * _PADDED_COLUMNS + _LEFT
        targets = first * REGISTRATION_UNITS_PER_PX + np.where(is_inside, column, 0)
        self._targets = targets.astype(np.int32)
        self._skipped_pixels = tables.skipped_pixels
        self._codes = np.full((ROWS + 1, _PADDED_COLUMNS), _EMPTY, np.uint16)

    def __call__(self, packed: NDArray[np.uint8], depth_mm: NDArray[np.uint16]) -> None:
        """Convert (422400,) packed values to (480, 640) millimeters; 0 = no reading."""
        _register(packed, self._entries, self._targets, self._codes.reshape(-1))
        _take_depth(self._codes, depth_mm)
        if self._skipped_pixels:
            pixels = depth_mm.reshape(-1)
            pixels[: -self._skipped_pixels] = pixels[self._skipped_pixels :].copy()
            pixels[-self._skipped_pixels :] = 0


def compile_kernels() -> None:
    """Compile the kernels, or load them."""
    tables = DepthTables(
        np.zeros(RAW_VALUES, np.uint16),
        np.zeros(MAX_DEPTH_MM, np.int32),
        np.zeros((ROWS, COLUMNS, 2), np.int32),
        skipped_pixels=0,
    )
    for convert in (UnregisteredDepth(tables), RegisteredDepth(tables)):
        convert(np.zeros(ROWS * COLUMNS * 11 // 8, np.uint8), np.empty((ROWS, COLUMNS), np.uint16))


@inline_kernel
def _unpack(packed: NDArray[np.uint8], group: int) -> tuple[np.uint64, ...]:
    """Unpack 8 values from 11 bytes, the highest bit first."""
    at, high = np.uint64(11) * np.uint64(group), np.uint64(0)
    for byte in range(8):
        high = high << np.uint64(8) | np.uint64(packed[at + np.uint64(byte)])
    low = high
    for byte in range(8, 11):
        low = low << np.uint64(8) | np.uint64(packed[at + np.uint64(byte)])
    mask = np.uint64(RAW_VALUES - 1)
    return (
        high >> np.uint64(53),
        high >> np.uint64(42) & mask,
        high >> np.uint64(31) & mask,
        high >> np.uint64(20) & mask,
        high >> np.uint64(9) & mask,
        low >> np.uint64(22) & mask,
        low >> np.uint64(11) & mask,
        low & mask,
    )


@kernel
def _look_up(
    packed: NDArray[np.uint8], table: NDArray[np.uint16], result: NDArray[np.uint16]
) -> None:
    for group in range(len(result) // 8):
        raw = _unpack(packed, group)
        for i in range(8):
            result[8 * group + i] = table[raw[i]]


@kernel
def _register(
    packed: NDArray[np.uint8],
    entries: NDArray[np.int64],
    targets: NDArray[np.int32],
    codes: NDArray[np.uint16],
) -> None:
    """Store each reading's code at its target, if no smaller one is there.

    Args:
        entries: (2048,) shift and code of each raw value: the shift is above the 16 bits of the
            code.
        targets: (307200,) flat index of each pixel's target in `codes`, in the registration's
            units, without the shift.
        codes: Flat image with margins.
    """
    for group in range(len(targets) // 8):
        raw = _unpack(packed, group)
        first = np.uint64(8) * np.uint64(group)
        for i in range(8):
            entry = entries[raw[i]]
            target = np.uint64(
                (np.int64(targets[first + np.uint64(i)]) + (entry >> np.int64(16))) >> np.int64(8)
            )
            codes[target] = min(codes[target], np.uint16(entry))


@kernel
def _take_depth(codes: NDArray[np.uint16], depth_mm: NDArray[np.uint16]) -> None:
    """Take the image from between the margins, and empty it for the next one.

    libfreenect rounds columns towards 0, so the last column of the margin belongs to the first one.
    """
    for y in range(ROWS):
        row, result = codes[y], depth_mm[y]
        row[_LEFT] = min(row[_LEFT], row[_LEFT - 1])
        row[_LEFT - 1] = _EMPTY
        for x in range(COLUMNS):
            code = row[_LEFT + x]
            row[_LEFT + x] = _EMPTY
            result[x] = np.uint16(0) if code & np.uint16(1) else code >> np.uint16(1)
