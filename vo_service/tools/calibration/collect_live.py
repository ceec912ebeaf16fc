"""Collection of views from a live camera, with instructions for the user with the board."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.calibration import UNKNOWN_TIMING
from drivers.camera import CameraStatus, PlaybackMode, RgbdCamera, RgbdFrame, SensorConfig
from drivers.core.errors import InputError, UserFacingError
from drivers.registry import open_camera
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
    """Settings of a live collection: camera, number of views, output folder and viewers."""

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
    """Guide the user until the views are complete, the camera ends, or `stop` is set.

    Args:
        board: The board.
        request: Settings.
        previews: Places where the views are shown; may be empty.
        terminal: Shows the instructions.
        stop: Ends the collection.

    Raises:
        UserFacingError: No image showed the board, or the camera cannot be opened.
    """
    selector = ViewSelector(board)
    guide = CoverageGuide(selector, request.view_count, request.with_depth)
    with (
        _open_raw_camera(request) as camera,
        _open_frame_writer(request.save_folder) as save_frame,
    ):
        units = DepthUnits(MILLIMETER_DEPTH_FACTOR)
        for frame in read_frames(camera, stop):
            if frame is None:
                terminal.show(_waiting_message(camera.status))
                continue
            snapshot = make_snapshot(frame, request.with_depth)
            decision = selector.process(snapshot)
            if decision is ViewDecision.ACCEPTED:
                # Stamps one second apart make the saved frames photographs, not a video. A board
                # does not tell the timing.
                photograph = replace(frame, readout_s=0.0, timing_prior=UNKNOWN_TIMING)
                save_frame(replace(photograph, stamp_s=float(len(selector.views))))
                units = replace(units, depth_factor=frame.depth_factor)
            terminal.show(guide.instruction(decision))
            for preview in previews:
                preview.show(
                    BoardPreviewFrame(
                        snapshot,
                        selector.corners,
                        tuple(selector.views),
                        guide.instruction(decision),
                    )
                )
            if guide.is_complete:
                break
    terminal.clear()
    if not selector.board_count:
        raise UserFacingError(
            f"no image of the camera showed a {board.name}; {BOARD_NOT_FOUND_HINT}"
        )
    return CollectedViews(selector.views, units, guide.gaps)


def _waiting_message(status: CameraStatus) -> str:
    return f"waiting for the camera: {status.reason or status.state}"


@contextmanager
def _open_raw_camera(request: LiveCollectionRequest) -> Iterator[RgbdCamera]:
    """Open the camera without rectification of its images."""
    if request.source.partition(":")[0] == "synthetic":
        raise InputError(
            "--camera synthetic: never shows a board, and its lens is known; use a real camera"
        )
    with write_raw_camera_file(request.with_depth) as file:
        live_camera = open_camera(
            request.source,
            camera_file=file,
            playback_mode=PlaybackMode.LOCKSTEP,
            # Drivers mirror images after undistortion and registration.
            sensor=replace(request.sensor, mirror=False),
        )
        with live_camera as camera:
            yield camera


@contextmanager
def _open_frame_writer(folder: Path | None) -> Iterator[Callable[[RgbdFrame], None]]:
    """Yield a function that writes frames into a new folder, or does nothing."""
    if folder is None:
        yield lambda frame: None
        return
    with TumWriter(folder) as writer:
        yield writer.write
