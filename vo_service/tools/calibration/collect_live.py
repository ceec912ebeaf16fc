"""From a camera, and whoever holds the board before it, to the views of a calibration."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.camera import CameraStatus, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core.errors import InputError, UserFacingError
from drivers.registry import CameraRequest, make_camera
from drivers.sensor_config import SensorConfig
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.writer import TumWriter
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.collect import BOARD_NOT_FOUND_HINT, CollectedViews
from vo_service.tools.calibration.coverage import CoverageGuide
from vo_service.tools.calibration.image_folder import MILLIMETER_DEPTH_FACTOR, DepthUnits
from vo_service.tools.calibration.live_snapshots import (
    make_snapshot,
    read_frames,
    write_raw_camera_file,
)
from vo_service.tools.calibration.preview import BoardPreview, BoardPreviewFrame
from vo_service.tools.calibration.view_selection import ViewDecision, ViewSelector


@dataclass(frozen=True)
class LiveCollectionRequest:
    """What to see live: camera and settings, how many views, where to keep and to watch them."""

    source: str
    sensor: SensorConfig
    with_depth: bool
    view_count: int
    save_folder: Path | None


def collect_live(
    board: Board,
    request: LiveCollectionRequest,
    previews: Sequence[BoardPreview],
    terminal: Terminal,
    stop: threading.Event,
) -> CollectedViews:
    """Guide whoever holds the board until the views are enough, the camera ends, or `stop`.

    Raises what opening the camera raises, and UserFacingError if the board was never seen.
    """
    picker = ViewSelector(board)
    guide = CoverageGuide(picker, request.view_count, request.with_depth)
    with (
        _open_raw_camera(request) as camera,
        _open_frame_writer(request.save_folder) as keep,
    ):
        units = DepthUnits(MILLIMETER_DEPTH_FACTOR)
        for frame in read_frames(camera, stop):
            if frame is None:
                terminal.show(_waiting_message(camera.status))
                continue
            seen = make_snapshot(frame, request.with_depth)
            verdict = picker.process(seen)
            if verdict is ViewDecision.ACCEPTED:
                # Photographs, a second apart: views are still, however quickly they followed.
                keep(replace(frame, stamp_s=float(len(picker.views))))
                units = replace(units, depth_factor=frame.depth_factor)
            terminal.show(guide.instruction(verdict))
            for preview in previews:
                preview.show(
                    BoardPreviewFrame(
                        seen, picker.corners, tuple(picker.views), guide.instruction(verdict)
                    )
                )
            if guide.is_complete:
                break
    terminal.clear()
    if not picker.board_count:
        raise UserFacingError(f"the camera never saw a {board.name}; {BOARD_NOT_FOUND_HINT}")
    return CollectedViews(picker.views, units, guide.gaps)


def _waiting_message(status: CameraStatus) -> str:
    return f"waiting for the camera: {status.reason or status.state}"


@contextmanager
def _open_raw_camera(request: LiveCollectionRequest) -> Iterator[RgbdCamera]:
    """The camera, open, with nothing taken out of its images."""
    if request.source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: it never shows a board, and its lens is known")
    with write_raw_camera_file(request.with_depth) as file:
        camera = make_camera(
            CameraRequest(
                source=request.source,
                camera_file=file,
                playback_mode=PlaybackMode.LOCKSTEP,
                # Drivers mirror what they have undistorted and registered.
                sensor=replace(request.sensor, mirror=False),
                synthetic=SyntheticConfig.fast(),
            )
        )
        with camera:
            yield camera


@contextmanager
def _open_frame_writer(folder: Path | None) -> Iterator[Callable[[RgbdFrame], None]]:
    """Writes frames into a new folder, or nowhere."""
    if folder is None:
        yield lambda frame: None
        return
    with TumWriter(folder) as writer:
        yield writer.write
