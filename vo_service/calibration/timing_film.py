"""The briskest pieces of a recording, or of what a camera shows within a minute."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.camera import Pace, RgbdCamera
from drivers.camera_file import CameraFile, camera_of_folder, read_camera_file
from drivers.errors import InputError
from drivers.sensor_settings import SensorSettings
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.camera import TumCamera
from vo_service.calibration.live import frames
from vo_service.calibration.timing_pieces import BriskestPieces, Piece
from vo_service.cameras import CameraRequest, make_camera
from vo_service.terminal import Terminal

MINUTE_S = 60.0

# Told after each frame: what was seen so far, and for how long.
Report = Callable[[BriskestPieces, float], None]


@dataclass(frozen=True)
class Film:
    """Pieces whose frames carry the skew of their stamps alone, the briskest first.

    camera       the camera file that it was seen with
    frame_count  frames that were looked at
    """

    pieces: list[Piece]
    camera: CameraFile
    frame_count: int


def film_of_folder(
    folder: Path, file: Path | None, terminal: Terminal, stop: threading.Event
) -> Film:
    """Of a recording. Raises InputError if it is no use."""
    camera_file = camera_of_folder(folder, file)
    with TumCamera(folder, file) as camera:

        def report(seen: BriskestPieces, seconds: float) -> None:
            terminal.progress("looking for brisk motion: frame", seen.seen, camera.frame_count)

        return _film(camera, camera_file, math.inf, report, stop)


def film_live(
    source: str, file: Path, sensor: SensorSettings, terminal: Terminal, stop: threading.Event
) -> Film:
    """Of a minute of a camera, less at `stop`. Raises what opening the camera raises."""
    if source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: its timing is known; record it and name the folder")
    camera_file = read_camera_file(file)
    request = CameraRequest(
        source=source,
        file=file,
        pace=Pace.LOCKSTEP,
        sensor=sensor,
        synthetic=SyntheticConfig.light(),
    )

    def report(seen: BriskestPieces, seconds: float) -> None:
        terminal.show(
            f"shake it briskly: {seconds:.0f} of {MINUTE_S:.0f} s, so far by up to "
            f"{math.degrees(seen.shake_rad_s):.0f} deg/s (Ctrl-C: enough)"
        )

    with make_camera(request) as camera:
        return _film(camera, camera_file, MINUTE_S, report, stop)


def _film(
    camera: RgbdCamera,
    camera_file: CameraFile,
    longest_s: float,
    report: Report,
    stop: threading.Event,
) -> Film:
    seen = BriskestPieces()
    begin_s = math.inf
    for frame in frames(camera, stop):
        if frame is None:
            continue
        begin_s = min(begin_s, frame.stamp_s)
        if frame.stamp_s - begin_s > longest_s:
            break
        seen.offer(replace(frame, skew_s=frame.skew_s - camera_file.depth_offset_s))
        report(seen, frame.stamp_s - begin_s)
    return Film(seen.kept, camera_file, seen.seen)
