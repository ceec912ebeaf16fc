"""The cost of a timing on a rendered segment."""

from collections.abc import Sequence

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, remove_depth
from tests.vo_service.tools.calibration.shaken_sequence import FAST_SHAKING, render_segment
from vo_service.tools.calibration.timing_cost import (
    SensorTiming,
    fit_velocity,
    timing_costs,
    track_motion,
)

pytestmark = pytest.mark.slow

TRUE = SensorTiming(0.012, -0.007)


@pytest.fixture(scope="module")
def segment() -> Sequence[RgbdFrame]:
    return render_segment(TRUE.readout_s, TRUE.depth_offset_s)


def test_constant_motion_has_its_velocity_with_irregular_stamps() -> None:
    stamps_s = np.array([0.0, 0.02, 0.07, 0.1, 0.2])
    velocity = fit_velocity([BRISK.pose_at(time_s) for time_s in stamps_s], stamps_s)
    np.testing.assert_allclose(velocity, BRISK.velocity, atol=1e-9)


def test_a_shaken_camera_has_the_instantaneous_velocity() -> None:
    stamps_s = 0.3 + np.arange(-2, 3) / 30
    velocity = fit_velocity([FAST_SHAKING.pose_at(time_s) for time_s in stamps_s], stamps_s)
    before, after = FAST_SHAKING.pose_at(0.2999), FAST_SHAKING.pose_at(0.3001)
    translation_m = before[:3, :3].T @ (after[:3, 3] - before[:3, 3])
    np.testing.assert_allclose(velocity[:3], translation_m / 0.0002, atol=0.01)


def test_the_true_timing_costs_less_than_any_other(segment: Sequence[RgbdFrame]) -> None:
    readouts = [TRUE, SensorTiming(0.004, -0.007), SensorTiming(0.020, -0.007)]
    offsets = [SensorTiming(0.012, -0.013), SensorTiming(0.012, -0.001)]
    costs = timing_costs(segment, SensorTiming(0.018, 0.0), [*readouts, *offsets])
    assert costs[0] < costs[1:].min() - 0.01


def test_a_segment_without_depth_has_no_costs(segment: Sequence[RgbdFrame]) -> None:
    without_depth = [remove_depth(frame) for frame in segment]
    assert track_motion(without_depth, TRUE) == {}
    assert np.isnan(timing_costs(without_depth, TRUE, [TRUE])).all()
