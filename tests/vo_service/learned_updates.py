"""Frames of a sensor and what was learned from them, for the memory of sensors."""

from dataclasses import replace

import numpy as np

from drivers.calibration import KINECT_READOUT_S, KINECT_TIMING_PRIOR
from drivers.camera import RgbdFrame, TimingPrior
from tests.vo_service.fakes import good_estimate, make_frame
from tests.vo_service.outputs.recorder.recorder_inputs import make_update
from vo_service.sensor_memory import RememberedFocalLength, RememberedSensor
from vo_service.types.estimate import LEARNED_TIMING, OnlineFocalLength, OnlineTiming
from vo_service.types.level import Level
from vo_service.types.odometry_update import OdometryUpdate

SERIAL = "A00123456789012A"
LEARNED = RememberedSensor(SERIAL, 0.0305, -0.0027, 0.0012, 0.0006)
FOCAL_LENGTH = RememberedFocalLength(make_frame(0).camera.fx, 1.035, 0.006, -0.08)


def sensor_frame(
    serial: str = SERIAL, prior: TimingPrior | None = KINECT_TIMING_PRIOR
) -> RgbdFrame:
    """A frame whose stamps differ by 5 ms, as the driver delivers it."""
    return replace(
        make_frame(0),
        serial=serial,
        skew_s=0.005,
        readout_s=KINECT_READOUT_S,
        timing_prior=prior,
    )


def learned_update(
    timing: RememberedSensor = LEARNED, source: str = LEARNED_TIMING
) -> OdometryUpdate:
    """The update of a frame after which the timing is this."""
    online = OnlineTiming(
        timing.readout_s,
        timing.depth_offset_s,
        timing.readout_sigma_s,
        timing.depth_offset_sigma_s,
        source,
    )
    focal = timing.focal_length
    focal_length = (
        OnlineFocalLength(focal.scale, focal.sigma, focal.disagreement) if focal else None
    )
    return replace(
        make_update(0),
        frame=sensor_frame(timing.serial),
        estimate=replace(good_estimate(np.eye(4)), timing=online, focal_length=focal_length),
        level=Level(accelerometer_bias_m_s2=timing.accelerometer_bias_m_s2),
    )
