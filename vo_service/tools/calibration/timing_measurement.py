"""Measurement of a sensor's timing from fast motion, by the odometry that learns it."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.calibration import (
    UNKNOWN_TIMING,
    UNKNOWN_TIMING_SIGMAS_S,
    CameraCalibration,
    read_calibration,
)
from drivers.camera import PlaybackMode, RgbdCamera, RgbdFrame, SensorConfig
from drivers.core import InputError
from drivers.playback.camera import RecordingCamera
from drivers.recording.recording import ImageTopics
from drivers.registry import open_camera
from vo_service.odometry.direct.calibration import CalibrationFilter
from vo_service.odometry.direct.calibration_equations import TIMING
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
from vo_service.terminal import Terminal
from vo_service.tools.calibration.collect_live import read_frames
from vo_service.tools.calibration.timing import (
    SensorTiming,
    make_timing,
)

CAPTURE_DURATION_S = 60.0
# A live camera is observed no longer than until the readout and the depth offset are this certain.
SUFFICIENT_SIGMAS_S = (0.0012, 0.0006)


class TimingMeasurement:
    """Learns the timing from the frames alone, whatever they tell of it.

    Attributes:
        frame_count: Number of processed frames.
    """

    def __init__(self) -> None:
        self.frame_count = 0
        self._odometry = SelfCalibratingOdometry(DirectOdometry())
        self._learned: CalibrationFilter | None = None

    def process(self, frame: RgbdFrame) -> None:
        """Process the next frame; its skew is the difference of its stamps."""
        self.frame_count += 1
        self._odometry.estimate(replace(frame, readout_s=0.0, timing_prior=UNKNOWN_TIMING))
        self._learned = self._odometry.calibration

    @property
    def timing(self) -> SensorTiming:
        """The timing so far."""
        learned = self._learned
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


# Is called after each frame with the measurement so far and the elapsed time, s.
ProgressCallback = Callable[[TimingMeasurement, float], None]


@dataclass(frozen=True)
class MeasuredTiming:
    """Result of a measurement.

    Attributes:
        timing: The timing, from the frames alone.
        camera: Camera file of the frames.
        frame_count: Number of processed frames.
    """

    timing: SensorTiming
    camera: CameraCalibration
    frame_count: int


def measure_folder(
    folder: Path,
    file: Path | None,
    topics: ImageTopics | None,
    terminal: Terminal,
    stop: threading.Event,
) -> MeasuredTiming:
    """Measure the timing of a recording.

    Args:
        file: Its camera file; None: the one in the recording.
        topics: As for `open_recording`.

    Raises:
        InputError: If it is not usable.
    """
    with RecordingCamera(folder, file, topics=topics) as camera:

        def report(measurement: TimingMeasurement, seconds: float) -> None:
            terminal.progress("frame", measurement.frame_count, camera.frame_count)

        return _measure(camera, camera.recording.calibration, math.inf, report, stop)


def measure_live(
    source: str, file: Path, sensor: SensorConfig, terminal: Terminal, stop: threading.Event
) -> MeasuredTiming:
    """Measure the timing of a live camera for a minute, until it is certain, or until `stop`.

    Args:
        source: The camera, as for --camera.

    Raises:
        CameraError: If that fails.
    """
    if source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: its timing is known; record it and name the folder")
    camera_file = read_calibration(file)
    live_camera = open_camera(
        source, camera_file=file, playback_mode=PlaybackMode.LOCKSTEP, sensor=sensor
    )

    def report(measurement: TimingMeasurement, seconds: float) -> None:
        timing = measurement.timing
        terminal.show(
            f"shake the camera: {seconds:.0f} of {CAPTURE_DURATION_S:.0f} s, readout "
            f"{timing['readout_s']}, depth offset {timing['depth_offset_s']} (Ctrl-C: enough)"
        )

    with live_camera as camera:
        return _measure(camera, camera_file, CAPTURE_DURATION_S, report, stop)


def _measure(
    camera: RgbdCamera,
    camera_file: CameraCalibration,
    max_duration_s: float,
    on_progress: ProgressCallback,
    stop: threading.Event,
) -> MeasuredTiming:
    measurement = TimingMeasurement()
    begin_s = math.inf
    for frame in read_frames(camera, stop):
        if frame is None:
            continue
        begin_s = min(begin_s, frame.stamp_s)
        elapsed_s = frame.stamp_s - begin_s
        if elapsed_s > max_duration_s:
            break
        measurement.process(replace(frame, skew_s=frame.skew_s - camera_file.depth_offset_s))
        on_progress(measurement, elapsed_s)
        if measurement.is_sufficient and max_duration_s < math.inf:
            break
    return MeasuredTiming(measurement.timing, camera_file, measurement.frame_count)
