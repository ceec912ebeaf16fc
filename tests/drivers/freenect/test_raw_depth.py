"""Depth from raw values: what `test_conversion` does not see with a simulated Kinect."""

from dataclasses import replace

import numpy as np

from drivers.freenect.depth_tables import (
    COLUMNS,
    MAX_DEPTH_MM,
    RAW_VALUES,
    REGISTRATION_UNITS_PER_PX,
    ROWS,
    DepthTables,
)
from drivers.freenect.raw_depth import RegisteredDepth
from tests.simulators.usb_frames import DEPTH_BITS, pack_bits

NEAR, FAR, AMBIGUOUS, NO_READING = 500, 900, 400, 2047


def make_tables() -> DepthTables:
    """Raw values are twice as many millimeters; those from 1000 on repeat a nearer distance."""
    raw_to_mm = (2 * np.arange(RAW_VALUES)).astype(np.uint16)
    raw_to_mm[1000:] = raw_to_mm[AMBIGUOUS]
    raw_to_mm[NO_READING] = 0
    registration = np.empty((ROWS, COLUMNS, 2), np.int32)
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    registration[..., 0], registration[..., 1] = REGISTRATION_UNITS_PER_PX * columns, rows
    return DepthTables(raw_to_mm, np.zeros(MAX_DEPTH_MM, np.int32), registration, 0)


def pack(raw: np.ndarray) -> np.ndarray:
    return pack_bits(raw.astype(np.uint16), DEPTH_BITS)


def register(tables: DepthTables, raw: np.ndarray) -> np.ndarray:
    return convert(RegisteredDepth(tables), raw)


def convert(to_mm: RegisteredDepth, raw: np.ndarray) -> np.ndarray:
    depth_mm = np.empty((ROWS, COLUMNS), np.uint16)
    to_mm(pack(raw), depth_mm)
    return depth_mm


def empty_raw() -> np.ndarray:
    return np.full((ROWS, COLUMNS), NO_READING)


def test_of_two_readings_of_a_pixel_the_nearer_is_kept_in_any_order() -> None:
    tables = make_tables()
    tables.registration[0, :2] = tables.registration[7, :2] = (5 * REGISTRATION_UNITS_PER_PX, 3)
    raw = empty_raw()
    raw[0, :2], raw[9, 9] = (NEAR, FAR), FAR
    depth_mm = register(tables, raw)
    raw[0, :2] = FAR, NEAR
    assert np.array_equal(register(tables, raw), depth_mm)
    assert (depth_mm[3, 5], depth_mm[9, 9]) == (2 * NEAR, 2 * FAR)
    assert np.count_nonzero(depth_mm) == 2


def test_an_ambiguous_reading_hides_those_behind_it() -> None:
    tables = make_tables()
    tables.registration[0, :2] = (5 * REGISTRATION_UNITS_PER_PX, 3)
    raw = empty_raw()
    raw[0, :2] = AMBIGUOUS, FAR
    assert not register(tables, raw).any()


def test_nothing_remains_of_the_image_before() -> None:
    to_mm = RegisteredDepth(make_tables())
    assert (convert(to_mm, np.full((ROWS, COLUMNS), NEAR)) == 2 * NEAR).all()
    assert not convert(to_mm, empty_raw()).any()


def test_skipped_pixels_move_the_image() -> None:
    raw = np.random.default_rng(1).integers(300, 950, (ROWS, COLUMNS))
    whole = register(make_tables(), raw).ravel()
    moved = register(replace(make_tables(), skipped_pixels=480), raw).ravel()
    assert np.array_equal(moved[:-480], whole[480:])
    assert not moved[-480:].any()
