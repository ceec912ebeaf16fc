"""The pieces of a film in which the camera was shaken most: they tell its timing best.

At one speed a rolling shutter bends all images alike, which nothing in them tells. So what counts
is how much the speed changes within a piece.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from drivers.calibration import CameraCalibration, find_calibration, read_calibration
from drivers.camera import PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core.errors import InputError
from drivers.core.geometry import Array
from drivers.registry import CameraRequest, make_camera
from drivers.sensor_config import SensorConfig
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.camera import TumCamera
from vo_service.terminal import Terminal
from vo_service.tools.calibration.live_snapshots import read_frames

# Frames of a piece, and how many pieces are kept.
SEGMENT_FRAMES = 32
MAX_SEGMENTS = 8
# A longer time without a frame ends a piece.
MAX_GAP_S = 0.11
# Images are shrunk to this before their shift is measured.
THUMBNAIL_SIZE_PX = (80, 60)


@dataclass(frozen=True)
class MotionSegment:
    """Frames that follow one another.

    shake_rad_s  standard deviation of the speed at which the image moves
    """

    frames: tuple[RgbdFrame, ...]
    speed_sigma_rad_s: float


class FastestSegments:
    """Takes a film frame by frame and keeps its briskest pieces."""

    def __init__(self) -> None:
        self.segments: list[MotionSegment] = []
        self.frame_count = 0
        self._frames: list[RgbdFrame] = []
        self._speeds_rad_s: list[Array] = []
        self._thumbnail = np.zeros(THUMBNAIL_SIZE_PX[::-1], np.float32)
        self._window = cv2.createHanningWindow(THUMBNAIL_SIZE_PX, cv2.CV_32F)

    @property
    def speed_sigma_rad_s(self) -> float:
        """Of the briskest piece so far."""
        return self.segments[0].speed_sigma_rad_s if self.segments else 0.0

    def process(self, frame: RgbdFrame) -> None:
        """Look at the next frame."""
        self.frame_count += 1
        small = _make_thumbnail(frame)
        duration_s = frame.stamp_s - self._frames[-1].stamp_s if self._frames else 0.0
        if not 0.0 < duration_s <= MAX_GAP_S:
            self._start_segment()
        if self._frames:
            shift, _ = cv2.phaseCorrelate(self._thumbnail, small, self._window)
            scale = np.array([frame.camera.width, frame.camera.height]) / THUMBNAIL_SIZE_PX
            self._speeds_rad_s.append(scale * shift / (frame.camera.fx * duration_s))
        self._frames.append(frame)
        self._thumbnail = small
        if len(self._frames) == SEGMENT_FRAMES:
            self._finish_segment()
            self._start_segment()

    def _finish_segment(self) -> None:
        shake_rad_s = float(np.sqrt(np.var(self._speeds_rad_s, axis=0).sum()))
        pieces = [*self.segments, MotionSegment(tuple(self._frames), shake_rad_s)]
        self.segments = sorted(pieces, key=lambda piece: -piece.speed_sigma_rad_s)[:MAX_SEGMENTS]

    def _start_segment(self) -> None:
        self._frames, self._speeds_rad_s = [], []


def _make_thumbnail(frame: RgbdFrame) -> Array:
    small = cv2.resize(frame.color_bgr, THUMBNAIL_SIZE_PX, interpolation=cv2.INTER_AREA)
    gray: Array = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)
    return gray


CAPTURE_DURATION_S = 60.0

# Told after each frame: what was seen so far, and for how long.
ProgressCallback = Callable[[FastestSegments, float], None]


@dataclass(frozen=True)
class CollectedSegments:
    """Pieces whose frames carry the skew of their stamps alone, the briskest first.

    camera       the camera file that it was seen with
    frame_count  frames that were looked at
    """

    segments: list[MotionSegment]
    camera: CameraCalibration
    frame_count: int


def collect_segments_from_folder(
    folder: Path, file: Path | None, terminal: Terminal, stop: threading.Event
) -> CollectedSegments:
    """Of a recording. Raises InputError if it is no use."""
    camera_file = find_calibration(folder, file)
    with TumCamera(folder, file) as camera:

        def report(seen: FastestSegments, seconds: float) -> None:
            terminal.progress(
                "looking for brisk motion: frame", seen.frame_count, camera.frame_count
            )

        return _collect_segments(camera, camera_file, math.inf, report, stop)


def collect_segments_live(
    source: str, file: Path, sensor: SensorConfig, terminal: Terminal, stop: threading.Event
) -> CollectedSegments:
    """Of a minute of a camera, less at `stop`. Raises what opening the camera raises."""
    if source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: its timing is known; record it and name the folder")
    camera_file = read_calibration(file)
    request = CameraRequest(
        source=source,
        camera_file=file,
        playback_mode=PlaybackMode.LOCKSTEP,
        sensor=sensor,
        synthetic=SyntheticConfig.fast(),
    )

    def report(seen: FastestSegments, seconds: float) -> None:
        terminal.show(
            f"shake it briskly: {seconds:.0f} of {CAPTURE_DURATION_S:.0f} s, so far by up to "
            f"{math.degrees(seen.speed_sigma_rad_s):.0f} deg/s (Ctrl-C: enough)"
        )

    with make_camera(request) as camera:
        return _collect_segments(camera, camera_file, CAPTURE_DURATION_S, report, stop)


def _collect_segments(
    camera: RgbdCamera,
    camera_file: CameraCalibration,
    max_duration_s: float,
    on_progress: ProgressCallback,
    stop: threading.Event,
) -> CollectedSegments:
    seen = FastestSegments()
    begin_s = math.inf
    for frame in read_frames(camera, stop):
        if frame is None:
            continue
        begin_s = min(begin_s, frame.stamp_s)
        if frame.stamp_s - begin_s > max_duration_s:
            break
        seen.process(replace(frame, skew_s=frame.skew_s - camera_file.depth_offset_s))
        on_progress(seen, frame.stamp_s - begin_s)
    return CollectedSegments(seen.segments, camera_file, seen.frame_count)
