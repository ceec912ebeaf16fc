from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.simulators.raw_depth import (
    NOMINAL,
    RAW_NO_READING,
    RawDepthScale,
    fit_scale,
    mm_to_raw,
    quantize_mm,
    raw_to_mm,
)
from tests.simulators.usb_frames import pack_bits, to_bayer, write_usb_frames

EVERY_RAW = np.arange(2048, dtype=np.uint16)


@given(st.integers(9, 12), st.lists(st.integers(0, 511), min_size=16, max_size=16))
def test_packed_values_are_one_long_number(bits: int, values: list[int]) -> None:
    packed = pack_bits(np.array(values, np.uint16), bits)
    number = 0
    for value in values:
        number = number << bits | value
    assert packed.tobytes() == number.to_bytes(2 * bits)


def test_the_filters_are_green_red_above_blue_green() -> None:
    bgr = np.empty((4, 4, 3), np.uint8)
    bgr[:] = (1, 2, 3)
    assert to_bayer(bgr).tolist() == [[2, 3, 2, 3], [1, 2, 1, 2]] * 2


@given(st.integers(320, 9000))
def test_a_distance_becomes_the_nearest_raw_value(mm: int) -> None:
    offered = raw_to_mm(EVERY_RAW).astype(int)
    error = np.where(offered > 0, abs(offered - mm), 100_000)
    raw = mm_to_raw(np.array(mm, np.uint16))
    assert error[raw] == error.min()


@given(st.integers(0, 2047))
def test_quantizing_twice_changes_nothing(raw: int) -> None:
    mm = raw_to_mm(np.array(raw, np.uint16))
    assert quantize_mm(mm) == mm


def test_depth_out_of_range_is_no_reading() -> None:
    assert mm_to_raw(np.array([0, 200, 10_000, 65_535], np.uint16)).tolist() == [RAW_NO_READING] * 4
    assert raw_to_mm(np.array([RAW_NO_READING, 1100], np.uint16)).tolist() == [0, 0]


def test_the_steps_of_depth_grow_with_its_square() -> None:
    step_mm = {
        z: np.diff(raw_to_mm(mm_to_raw(np.array(z)) + np.array([0, 1]))) for z in (1000, 3000)
    }
    assert step_mm[3000] / step_mm[1000] == pytest.approx(9.0, rel=0.3)


def test_a_kinect_has_the_usual_focal_length() -> None:
    assert NOMINAL.focal_px == pytest.approx(575.8, abs=0.1)


@pytest.mark.slow
@given(st.floats(7.45, 7.55), st.floats(118.8, 121.2))
def test_the_scale_of_the_recording_kinect_is_found(emitter_cm: float, reference_cm: float) -> None:
    recorder = RawDepthScale(emitter_cm, reference_cm)
    recorded = quantize_mm(np.arange(600, 4500, dtype=np.uint16), recorder)
    quantized = quantize_mm(recorded, fit_scale([recorded]))
    assert abs(quantized.astype(int) - recorded).max() <= 1


def test_without_readings_the_scale_is_nominal() -> None:
    assert fit_scale([np.zeros((480, 640), np.uint16)]) == NOMINAL


def test_an_image_of_another_size_is_rejected(tmp_path: Path) -> None:
    depth = np.zeros((480, 640), np.uint16)
    with pytest.raises(ValueError, match="480, 640, 3"):
        write_usb_frames(tmp_path, [(np.zeros((240, 320, 3), np.uint8), depth)])
