"""Segments of a recording with the fastest shaking, which determine the sensor's timing best.

At constant speed a rolling shutter distorts all images equally, so that the distortion is not
observable. The change of speed within a segment matters.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from drivers.calibration import CameraCalibration, find_calibration, read_calibration
from drivers.camera import PlaybackMode, RgbdCamera, RgbdFrame, SensorConfig
from drivers.core.errors import InputError
from drivers.core.geometry import Array
from drivers.registry import open_camera
from drivers.tum.camera import TumCamera
from vo_service.terminal import Terminal
from vo_service.tools.calibration.live_snapshots import read_frames

# Frames of a segment, and number of stored segments.
SEGMENT_FRAMES = 32
MAX_SEGMENTS = 8
# A longer time without a frame ends a segment.
MAX_GAP_S = 0.11
# Images are reduced to this size for the measurement of their shift.
THUMBNAIL_SIZE_PX = (80, 60)


@dataclass(frozen=True)
class MotionSegment:
    """Successive frames; `speed_sigma_rad_s` is the standard deviation of the image's speed."""

    frames: tuple[RgbdFrame, ...]
    speed_sigma_rad_s: float


class FastestSegments:
    """Collector of the fastest segments from a stream of frames."""

    def __init__(self) -> None:
        self.segments: list[MotionSegment] = []
        self.frame_count = 0
        self._frames: list[RgbdFrame] = []
        self._speeds_rad_s: list[Array] = []
        self._thumbnail = np.zeros(THUMBNAIL_SIZE_PX[::-1], np.float32)
        self._window = cv2.createHanningWindow(THUMBNAIL_SIZE_PX, cv2.CV_32F)

    @property
    def speed_sigma_rad_s(self) -> float:
        """Standard deviation of the speed of the fastest segment so far."""
        return self.segments[0].speed_sigma_rad_s if self.segments else 0.0

    def process(self, frame: RgbdFrame) -> None:
        """Process the next frame."""
        self.frame_count += 1
        thumbnail = _make_thumbnail(frame)
        duration_s = frame.stamp_s - self._frames[-1].stamp_s if self._frames else 0.0
        if not 0.0 < duration_s <= MAX_GAP_S:
            self._start_segment()
        if self._frames:
            shift, _ = cv2.phaseCorrelate(self._thumbnail, thumbnail, self._window)
            scale = np.array([frame.camera.width, frame.camera.height]) / THUMBNAIL_SIZE_PX
            self._speeds_rad_s.append(scale * shift / (frame.camera.fx * duration_s))
        self._frames.append(frame)
        self._thumbnail = thumbnail
        if len(self._frames) == SEGMENT_FRAMES:
            self._finish_segment()
            self._start_segment()

    def _finish_segment(self) -> None:
        speed_sigma_rad_s = float(np.sqrt(np.var(self._speeds_rad_s, axis=0).sum()))
        segments = [*self.segments, MotionSegment(tuple(self._frames), speed_sigma_rad_s)]
        self.segments = sorted(segments, key=lambda segment: -segment.speed_sigma_rad_s)[
            :MAX_SEGMENTS
        ]

    def _start_segment(self) -> None:
        self._frames, self._speeds_rad_s = [], []


def _make_thumbnail(frame: RgbdFrame) -> Array:
    thumbnail = cv2.resize(frame.color_bgr, THUMBNAIL_SIZE_PX, interpolation=cv2.INTER_AREA)
    gray: Array = cv2.cvtColor(thumbnail, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return gray


CAPTURE_DURATION_S = 60.0

# Is called after each frame with the segments so far and the elapsed time, s.
ProgressCallback = Callable[[FastestSegments, float], None]


@dataclass(frozen=True)
class CollectedSegments:
    """Segments whose frames have the skew of their stamps only, the fastest first.

    Attributes:
        segments: The segments.
        camera: Camera file of the recording.
        frame_count: Number of processed frames.
    """

    segments: list[MotionSegment]
    camera: CameraCalibration
    frame_count: int


def collect_segments_from_folder(
    folder: Path, file: Path | None, terminal: Terminal, stop: threading.Event
) -> CollectedSegments:
    """Collect segments of a recording.

    Raises:
        InputError: If it is not usable.
    """
    camera_file = find_calibration(folder, file)
    with TumCamera(folder, file) as camera:

        def report(fastest: FastestSegments, seconds: float) -> None:
            terminal.progress(
                "looking for fast motion: frame", fastest.frame_count, camera.frame_count
            )

        return _collect_segments(camera, camera_file, math.inf, report, stop)


def collect_segments_live(
    source: str, file: Path, sensor: SensorConfig, terminal: Terminal, stop: threading.Event
) -> CollectedSegments:
    """Collect segments of a live camera for a minute, or until `stop`.

    Raises:
        CameraError: If that fails.
    """
    if source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: its timing is known; record it and name the folder")
    camera_file = read_calibration(file)
    live_camera = open_camera(
        source, camera_file=file, playback_mode=PlaybackMode.LOCKSTEP, sensor=sensor
    )

    def report(fastest: FastestSegments, seconds: float) -> None:
        terminal.show(
            f"shake the camera fast: {seconds:.0f} of {CAPTURE_DURATION_S:.0f} s, so far up to "
            f"{math.degrees(fastest.speed_sigma_rad_s):.0f} deg/s (Ctrl-C: enough)"
        )

    with live_camera as camera:
        return _collect_segments(camera, camera_file, CAPTURE_DURATION_S, report, stop)


def _collect_segments(
    camera: RgbdCamera,
    camera_file: CameraCalibration,
    max_duration_s: float,
    on_progress: ProgressCallback,
    stop: threading.Event,
) -> CollectedSegments:
    fastest = FastestSegments()
    begin_s = math.inf
    for frame in read_frames(camera, stop):
        if frame is None:
            continue
        begin_s = min(begin_s, frame.stamp_s)
        if frame.stamp_s - begin_s > max_duration_s:
            break
        fastest.process(replace(frame, skew_s=frame.skew_s - camera_file.depth_offset_s))
        on_progress(fastest, frame.stamp_s - begin_s)
    return CollectedSegments(fastest.segments, camera_file, fastest.frame_count)
