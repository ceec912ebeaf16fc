"""A sensor's timing is measured from any images that the odometry takes."""

import pytest

from drivers.calibration import TUM_CALIBRATIONS
from tests.vo_service.odometry.direct.rolling_shutter_views import keep_depth_grid
from tests.vo_service.odometry.direct.swinging_camera import DELAY_S, READOUT_S, swinging_frames
from vo_service.tools.calibration.timing_measurement import TimingMeasurement


def test_the_timing_is_measured_with_a_sparse_grid_of_depth() -> None:
    measurement = TimingMeasurement(TUM_CALIBRATIONS["1"])
    for frame in swinging_frames(READOUT_S, DELAY_S):
        measurement.process(keep_depth_grid(frame, 3.0))
    timing = measurement.timing
    assert timing["readout_s"].value_s == pytest.approx(READOUT_S, abs=0.004)
    assert timing["depth_offset_s"].value_s == pytest.approx(DELAY_S, abs=0.003)
