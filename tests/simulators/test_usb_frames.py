from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.simulators.raw_depth import (
    NOMINAL,
    RawDepthScale,
    fit_scale,
    mm_to_raw,
    quantize_mm,
    raw_to_mm,
)
from tests.simulators.usb_frames import write_usb_frames

EVERY_RAW = np.arange(2048, dtype=np.uint16)


@given(st.integers(320, 9000))
def test_a_distance_becomes_the_nearest_raw_value(mm: int) -> None:
    offered = raw_to_mm(EVERY_RAW).astype(int)
    error = np.where(offered > 0, abs(offered - mm), 100_000)
    raw = mm_to_raw(np.array(mm, np.uint16))
    assert error[raw] == error.min()


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
