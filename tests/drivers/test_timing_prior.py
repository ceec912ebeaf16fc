"""How well a camera file tells the sensor's timing."""

from dataclasses import replace

import pytest

from drivers.calibration import (
    KINECT_READOUT_S,
    KINECT_TIMING_PRIOR,
    TUM_CALIBRATIONS,
    CameraCalibration,
    format_calibration,
    kinect_timing,
)
from drivers.camera import TimingPrior, TimingSource
from drivers.core.config import parse_toml

UNTOLD = TUM_CALIBRATIONS["1"]


def test_zeros_that_nobody_measured_are_unknown() -> None:
    assert UNTOLD.timing_prior == TimingPrior(0.0, 0.03, 0.01, TimingSource.UNKNOWN)


def test_values_without_a_sigma_were_measured() -> None:
    told = replace(UNTOLD, readout_s=0.02, depth_offset_s=-0.003)
    assert told.timing_prior == TimingPrior(-0.003, 0.001, 0.0005, TimingSource.CAMERA_FILE)


def test_a_sigma_of_zero_makes_the_timing_exact() -> None:
    assert replace(UNTOLD, readout_sigma_s=0.0, depth_offset_sigma_s=0.0).timing_prior is None


@pytest.mark.parametrize("calibration", [None, UNTOLD])
def test_a_kinect_whose_file_tells_no_timing_has_the_usual_one(
    calibration: CameraCalibration | None,
) -> None:
    assert kinect_timing(calibration) == (KINECT_READOUT_S, KINECT_TIMING_PRIOR)


def test_a_kinect_has_the_timing_of_its_file() -> None:
    told = replace(UNTOLD, readout_s=0.03)
    assert kinect_timing(told) == (0.03, told.timing_prior)


def test_sigmas_are_kept_in_a_camera_file() -> None:
    told = replace(UNTOLD, readout_s=0.03, readout_sigma_s=0.002, depth_offset_sigma_s=0.001)
    assert parse_toml(format_calibration(told), "camera.toml", CameraCalibration) == told
