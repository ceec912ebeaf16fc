"""The briskest pieces of a recording, or of what a camera shows within a minute."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.camera import PlaybackMode, RgbdCamera
from drivers.camera_file import CameraCalibration, find_calibration, read_calibration
from drivers.errors import InputError
from drivers.sensor_settings import SensorConfig
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.camera import TumCamera
from vo_service.calibration.live import read_frames
from vo_service.calibration.timing_pieces import FastestSegments, MotionSegment
from vo_service.cameras import CameraRequest, make_camera
from vo_service.terminal import Terminal

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
