"""Views from a live camera, with instructions for the user with the board."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.calibration import (
    CAMERA_FILE_NAME,
    UNKNOWN_TIMING,
    DepthCameraCalibration,
    RigidTransform,
    format_calibration,
)
from drivers.camera import (
    EndOfStream,
    FrameTimeout,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
    SensorConfig,
)
from drivers.core import CameraError, InputError, UserFacingError
from drivers.recording.frame_recorder import FrameRecorder
from drivers.registry import open_camera
from drivers.tum.writer import TumFolder
from vo_service.outputs.rerun.preview import RerunPreview
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board, BoardCorners
from vo_service.tools.calibration.collect_folder import (
    BOARD_NOT_FOUND_HINT,
    RAW_CALIBRATION,
    CollectedViews,
)
from vo_service.tools.calibration.snapshot import NO_DEPTH, BoardView, Snapshot
from vo_service.tools.calibration.view_selection import CoverageGuide, ViewDecision, ViewSelector

POLL_PERIOD_S = 0.25
# A camera without frames for this time has failed.
FRAME_TIMEOUT_S = 15.0
# A depth camera at the same place with the same lens: registration moves no pixel.
RAW_DEPTH_CALIBRATION = DepthCameraCalibration(
    525.0, 525.0, 319.5, 239.5, RigidTransform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
)


@contextmanager
def write_raw_camera_file(with_depth: bool) -> Iterator[Path]:
    """Write a temporary camera file with which a driver returns raw images.

    Its `[depth]` table prevents registration by the sensor.
    """
    with TemporaryDirectory(prefix="kinect-vo-") as folder:
        file = Path(folder) / CAMERA_FILE_NAME
        depth = RAW_DEPTH_CALIBRATION if with_depth else None
        file.write_text(format_calibration(replace(RAW_CALIBRATION, depth=depth)))
        yield file


def read_frames(camera: RgbdCamera, stop: threading.Event) -> Iterator[RgbdFrame | None]:
    """Yield the camera's frames until its end or `stop`, and None while there is no frame.

    Raises:
        CameraError: There was no frame for `FRAME_TIMEOUT_S`.
    """
    last_s = time.monotonic()
    while not stop.is_set():
        try:
            frame = camera.read(POLL_PERIOD_S)
        except FrameTimeout as error:
            if time.monotonic() - last_s > FRAME_TIMEOUT_S:
                reason = camera.status.reason or "the camera sends no frames"
                raise CameraError(f"{camera.name}: {reason}") from error
            yield None
        except EndOfStream:
            return
        else:
            last_s = time.monotonic()
            yield frame


@dataclass(frozen=True)
class BoardPreviewFrame:
    """Snapshot with its corners, the accepted views so far, and the next instruction."""

    snapshot: Snapshot
    corners: BoardCorners
    views: tuple[BoardView, ...]
    advice: str


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
    previews: Sequence[RerunPreview[BoardPreviewFrame]],
    terminal: Terminal,
    stop: threading.Event,
) -> CollectedViews:
    """Guide the user until the views are complete, the camera ends, or `stop` is set.

    Raises:
        UserFacingError: No image showed the board, or the camera cannot be opened.
    """
    selector = ViewSelector(board)
    guide = CoverageGuide(selector, request.view_count, request.with_depth)
    with _open_raw_camera(request) as camera, _open_frame_writer(request.save_folder) as save_frame:
        known = RAW_CALIBRATION
        for frame in read_frames(camera, stop):
            if frame is None:
                status = camera.status
                terminal.show(f"waiting for the camera: {status.reason or status.state}")
                continue
            depth = frame.depth_raw if request.with_depth else NO_DEPTH
            snapshot = Snapshot(f"frame {frame.seq}", frame.stamp_s, frame.color_bgr, depth)
            decision = selector.process(snapshot)
            if decision is ViewDecision.ACCEPTED:
                # Stamps one second apart make the saved frames photographs, not a video. A board
                # does not tell the timing.
                photograph = replace(frame, readout_s=0.0, timing_prior=UNKNOWN_TIMING)
                save_frame(replace(photograph, stamp_s=float(len(selector.views))))
                known = replace(known, depth_factor=frame.depth_factor)
            advice, views = guide.instruction(decision), tuple(selector.views)
            terminal.show(advice)
            for preview in previews:
                preview.show(BoardPreviewFrame(snapshot, selector.corners, views, advice))
            if guide.is_complete:
                break
    terminal.clear()
    if not selector.board_count:
        raise UserFacingError(
            f"no image of the camera showed a {board.name}; {BOARD_NOT_FOUND_HINT}"
        )
    return CollectedViews(selector.views, known, guide.gaps)


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
    with FrameRecorder(TumFolder(folder)) as writer:
        yield writer.write
