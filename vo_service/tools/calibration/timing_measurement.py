"""Measurement of a sensor's timing from fast motion, by the odometry that learns it."""

import math
import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.calibration import UNKNOWN_TIMING, UNKNOWN_TIMING_SIGMAS_S, CameraCalibration
from drivers.camera import RgbdCamera, RgbdFrame
from vo_service.odometry.direct.calibration_equations import TIMING
from vo_service.odometry.direct.image_halving import HalvingOdometry
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.repeated_depth import RepeatedDepthFilter
from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
from vo_service.tools.calibration.collect_live import read_frames
from vo_service.tools.calibration.timing import SensorTiming, make_timing

# A live camera is observed no longer than until the readout and the depth offset are this certain.
SUFFICIENT_SIGMAS_S = (0.0012, 0.0006)


class TimingMeasurement:
    """Learns the timing of a camera from the frames alone, whatever they tell of it.

    Attributes:
        calibration: Camera file of the frames.
        frame_count: Number of processed frames.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self.calibration = calibration
        self.frame_count = 0
        self._learning = SelfCalibratingOdometry(DirectOdometry())
        self._odometry = RepeatedDepthFilter(HalvingOdometry(self._learning))

    def process_frames(
        self, camera: RgbdCamera, stop: threading.Event, max_duration_s: float = math.inf
    ) -> Iterator[float]:
        """Process the frames of an open camera until `stop`; yield the elapsed time after each, s.

        Args:
            max_duration_s: Longest elapsed time of a processed frame, s.

        Raises:
            CameraError: The camera fails.
        """
        begin_s = math.inf
        for frame in read_frames(camera, stop):
            if frame is None:
                continue
            begin_s = min(begin_s, frame.stamp_s)
            elapsed_s = frame.stamp_s - begin_s
            if elapsed_s > max_duration_s:
                return
            self.process(replace(frame, skew_s=frame.skew_s - self.calibration.depth_offset_s))
            yield elapsed_s

    def process(self, frame: RgbdFrame) -> None:
        """Process the next frame; its skew is the difference of its stamps."""
        self.frame_count += 1
        self._odometry.estimate(replace(frame, readout_s=0.0, timing_prior=UNKNOWN_TIMING))

    @property
    def timing(self) -> SensorTiming:
        """The timing so far."""
        learned = self._learning.calibration
        if learned is None:
            return make_timing(0.0, 0.0, *UNKNOWN_TIMING_SIGMAS_S)
        # A certain estimate may be exactly zero, which the mean of a Gaussian is not.
        values = learned.in_use if learned.is_certain else learned.estimate
        return make_timing(*values[TIMING].tolist(), *learned.sigmas[TIMING].tolist())

    @property
    def is_sufficient(self) -> bool:
        """Whether further frames would hardly change the timing."""
        sigmas_s = [value.sigma_s for value in self.timing.values()]
        return all(np.less_equal(sigmas_s, SUFFICIENT_SIGMAS_S))
