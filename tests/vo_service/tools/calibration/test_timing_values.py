"""Times with standard deviations: how they are combined, and which of them are saved."""

from dataclasses import replace

import pytest

from drivers.calibration import TUM_CALIBRATIONS
from vo_service.tools.calibration.timing import (
    USUAL_TIMING,
    TimingValue,
    combine,
    make_timing,
    select_changes,
    told_timing,
)

UNTOLD = TUM_CALIBRATIONS["1"]
MEASURED = make_timing(0.0272, -0.0021, 0.0022, 0.0035)


def test_a_measurement_is_combined_with_the_usual_values() -> None:
    combined = combine(MEASURED, USUAL_TIMING)
    assert combined["readout_s"].value_s == pytest.approx(0.0276, abs=1e-4)
    assert combined["readout_s"].sigma_s == pytest.approx(0.00193, abs=1e-5)
    assert combined["depth_offset_s"].sigma_s == pytest.approx(0.00287, abs=1e-5)


def test_a_kinect_whose_file_tells_nothing_has_the_usual_values() -> None:
    assert told_timing(UNTOLD, is_kinect=True) == USUAL_TIMING
    assert told_timing(UNTOLD) == make_timing(0.0, 0.0, 0.03, 0.01)


def test_a_sigma_of_zero_is_exact() -> None:
    exact = replace(UNTOLD, readout_sigma_s=0.0, depth_offset_sigma_s=0.0)
    assert told_timing(exact, is_kinect=True) == make_timing(0.0, 0.0, 0.0, 0.0)


def test_only_what_becomes_more_certain_is_saved() -> None:
    told = make_timing(0.029, 0.0, 0.001, 0.005)
    assert select_changes(told, MEASURED) == {"depth_offset_s": TimingValue(-0.0021, 0.0035)}


def test_a_value_that_is_contradicted_is_replaced() -> None:
    told = make_timing(0.019, 0.0, 0.001, 0.001)
    assert select_changes(told, MEASURED) == {"readout_s": TimingValue(0.0272, 0.0022)}


def test_a_repeated_measurement_is_saved() -> None:
    assert select_changes(MEASURED, MEASURED) == MEASURED


def test_a_negative_readout_is_zero() -> None:
    told = make_timing(0.0, 0.0, 0.03, 0.01)
    changes = select_changes(told, make_timing(-0.0004, 0.0, 0.001, 0.001))
    assert changes["readout_s"] == TimingValue(0.0, 0.001)
