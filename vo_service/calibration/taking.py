"""From a folder or a camera to the views that a calibration is made of."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.camera import Pace, RgbdCamera, RgbdFrame
from drivers.errors import InputError, UserFacingError
from drivers.sensor_settings import SensorSettings
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.writer import TumWriter
from vo_service.calibration.board import Board
from vo_service.calibration.folder import (
    MILLIMETRES,
    DepthUnits,
    ImageFiles,
    depth_units,
    image_files,
    snapshots,
)
from vo_service.calibration.guidance import Lack, lacks
from vo_service.calibration.guide import Guide
from vo_service.calibration.live import frames, raw_camera_file, snapshot
from vo_service.calibration.picking import Verdict, ViewPicker
from vo_service.calibration.snapshot import View
from vo_service.cameras import CameraRequest, make_camera
from vo_service.terminal import Terminal

# So many images of a folder are searched for another board when none shows the one asked for.
LOOKED_THROUGH = 12
WHAT_TO_CHECK = (
    "see that --board counts its inner corners (chessboard) or squares (charuco), that the whole "
    "chessboard with its white edge is in the image, sharp, and not mirrored or too bright"
)


@dataclass(frozen=True)
class Taken:
    """Views, what depth values mean in them, and what no view shows."""

    views: list[View]
    units: DepthUnits
    lacks: list[Lack]


@dataclass(frozen=True)
class LiveRequest:
    """What to see live: the camera, its settings, how many views, and where to keep them."""

    source: str
    sensor: SensorSettings
    with_depth: bool
    wanted: int
    keep: Path | None


def taken_from_folder(
    board: Board, folder: Path, camera_file: Path | None, with_depth: bool, terminal: Terminal
) -> Taken:
    """Every view in the folder in which the board is still and stands differently.

    Raises InputError if the folder is no use or shows no such board.
    """
    files = image_files(folder, with_depth)
    units = depth_units(folder, camera_file)
    picker = ViewPicker(board)
    for number, found in enumerate(snapshots(files), 1):
        if found is not None:
            picker.offer(found)
        views = f"{len(picker.views)} views; image"
        terminal.progress(views, number, len(files))
    terminal.clear()
    if not picker.showing:
        raise InputError(f"{folder}: {_no_board(board, files)}")
    return Taken(picker.views, units, lacks(picker.views, picker.stances, with_depth))


def _no_board(board: Board, files: list[ImageFiles]) -> str:
    """What to say of images without the board: perhaps they show another one."""
    count = len(files)
    spread = files[:: max(1, count // LOOKED_THROUGH)]
    seen = [board.seen_instead(found.grey) for found in snapshots(spread) if found is not None]
    others = [option for option in seen if option]
    if others:
        return (
            f"none of the {count} images shows a {board.name}, but some show another one: give "
            f"--board {max(set(others), key=others.count)}"
        )
    return f"none of the {count} images shows a {board.name}; {WHAT_TO_CHECK}"


def taken_live(
    board: Board, request: LiveRequest, terminal: Terminal, stop: threading.Event
) -> Taken:
    """Guide whoever holds the board until the views are enough, the camera ends, or `stop`.

    Raises what opening the camera raises, and UserFacingError if the board was never seen.
    """
    picker = ViewPicker(board)
    guide = Guide(picker, request.wanted, request.with_depth)
    with _raw_camera(request) as camera, _keeper(request.keep) as keep:
        units = DepthUnits(MILLIMETRES, camera.readout_s)
        for frame in frames(camera, stop):
            if frame is None:
                terminal.show(f"waiting for the camera: {camera.condition.reason}")
                continue
            verdict = picker.offer(snapshot(frame, request.with_depth))
            if verdict is Verdict.TAKEN:
                keep(frame)
                units = replace(units, depth_factor=frame.depth_factor)
            terminal.show(guide.text(verdict))
            if guide.is_done:
                break
    terminal.clear()
    if not picker.showing:
        raise UserFacingError(f"the camera never saw a {board.name}; {WHAT_TO_CHECK}")
    return Taken(picker.views, units, guide.lacks)


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
                progress=lambda done, total: None,
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
