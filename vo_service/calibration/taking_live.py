"""From a camera, and whoever holds the board before it, to the views of a calibration."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.camera import Condition, Pace, RgbdCamera, RgbdFrame
from drivers.errors import InputError, UserFacingError
from drivers.sensor_settings import SensorSettings
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.writer import TumWriter
from vo_service.calibration.board import Board
from vo_service.calibration.folder import MILLIMETRES, DepthUnits
from vo_service.calibration.guide import Guide
from vo_service.calibration.live import frames, raw_camera_file, snapshot
from vo_service.calibration.picking import Verdict, ViewPicker
from vo_service.calibration.taking import WHAT_TO_CHECK, Taken
from vo_service.calibration.watching import Sight
from vo_service.cameras import CameraRequest, make_camera
from vo_service.terminal import Terminal
from vo_service.viewer.preview import PreviewScene, open_previews


@dataclass(frozen=True)
class LiveRequest:
    """What to see live: camera and settings, how many views, where to keep and to watch them."""

    source: str
    sensor: SensorSettings
    with_depth: bool
    wanted: int
    keep: Path | None
    watch: tuple[str, ...]


def taken_live(
    board: Board, request: LiveRequest, terminal: Terminal, stop: threading.Event
) -> Taken:
    """Guide whoever holds the board until the views are enough, the camera ends, or `stop`.

    Raises what opening the camera raises, and UserFacingError if the board was never seen.
    """
    picker = ViewPicker(board)
    guide = Guide(picker, request.wanted, request.with_depth)
    with (
        open_previews(request.watch, "kinect-vo-calibrate", _scene, terminal.say) as previews,
        _raw_camera(request) as camera,
        _keeper(request.keep) as keep,
    ):
        units = DepthUnits(MILLIMETRES)
        for frame in frames(camera, stop):
            if frame is None:
                terminal.show(_waiting(camera.condition))
                continue
            seen = snapshot(frame, request.with_depth)
            verdict = picker.offer(seen)
            if verdict is Verdict.TAKEN:
                # Photographs, a second apart: views are still, however quickly they followed.
                keep(replace(frame, stamp_s=float(len(picker.views))))
                units = replace(units, depth_factor=frame.depth_factor)
            terminal.show(guide.text(verdict))
            for preview in previews:
                preview.show(Sight(seen, picker.corners, tuple(picker.views), guide.text(verdict)))
            if guide.is_done:
                break
    terminal.clear()
    if not picker.showing:
        raise UserFacingError(f"the camera never saw a {board.name}; {WHAT_TO_CHECK}")
    return Taken(picker.views, units, guide.lacks)


def _scene() -> type[PreviewScene[Sight]]:
    from vo_service.calibration.rerun_board import BoardScene  # imports rerun

    return BoardScene


def _waiting(condition: Condition) -> str:
    return f"waiting for the camera: {condition.reason or condition.state}"


@contextmanager
def _raw_camera(request: LiveRequest) -> Iterator[RgbdCamera]:
    """The camera, open, with nothing taken out of its images."""
    if request.source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: it never shows a board, and its lens is known")
    with raw_camera_file(request.with_depth) as file:
        camera = make_camera(
            CameraRequest(
                source=request.source,
                file=file,
                pace=Pace.LOCKSTEP,
                # Drivers mirror what they have undistorted and registered.
                sensor=replace(request.sensor, mirror=False),
                synthetic=SyntheticConfig.light(),
            )
        )
        with camera:
            yield camera


@contextmanager
def _keeper(folder: Path | None) -> Iterator[Callable[[RgbdFrame], None]]:
    """Writes frames into a new folder, or nowhere."""
    if folder is None:
        yield lambda frame: None
        return
    with TumWriter(folder) as writer:
        yield writer.write
