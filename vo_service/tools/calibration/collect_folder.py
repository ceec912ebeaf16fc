"""Views from a folder: a recording in TUM format, or photographs only."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME, NO_DISTORTION, CameraCalibration, find_calibration
from drivers.core import InputError
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.recorded_frames import RecordedImage
from drivers.tum.folder import read_frame_pairs
from drivers.tum.index_files import ListedImage, read_image_list
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.snapshot import NO_DEPTH, BoardView, Snapshot
from vo_service.tools.calibration.view_selection import (
    CoverageGap,
    ViewSelector,
    find_coverage_gaps,
)

SUFFIXES = (".png", ".jpg", ".jpeg")
# Without distortion: undistortion moves no pixel. Depth is in millimeters.
RAW_CALIBRATION = CameraCalibration(640, 480, 525.0, 525.0, 319.5, 239.5, NO_DISTORTION, 1000.0)
_log = logging.getLogger(__name__)
# If no image shows the requested board, this many images are searched for another one.
MAX_SEARCHED_IMAGES = 12
BOARD_NOT_FOUND_HINT = (
    "check that --board counts inner corners (chessboard) or squares (charuco); the whole "
    "chessboard with its white edge must be in the image, sharp, not mirrored and not too bright"
)


@dataclass(frozen=True)
class SnapshotFiles:
    """Images of one snapshot, not read yet; `depth` is None without depth."""

    color: RecordedImage
    depth: RecordedImage | None


def list_snapshot_files(folder: Path, with_depth: bool) -> list[SnapshotFiles]:
    """List the snapshots of a folder in order of time.

    Photographs without an index file get stamps one second apart.

    Raises:
        InputError: The folder has no images, or an index file is invalid.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; check the path")
    if (folder / "associations.txt").exists() or with_depth:
        pairs = read_frame_pairs(folder).pairs
        return [SnapshotFiles(pair.color, pair.depth if with_depth else None) for pair in pairs]
    if (folder / "rgb.txt").exists():
        return [SnapshotFiles(image, None) for image in read_image_list(folder / "rgb.txt")]
    return [
        SnapshotFiles(ListedImage(Decimal(n), file, str(file)), None)
        for n, file in enumerate(_list_photographs(folder))
    ]


def _list_photographs(folder: Path) -> list[Path]:
    for image_folder in (folder, folder / "rgb"):
        files = [file for file in image_folder.glob("*") if file.suffix.lower() in SUFFIXES]
        if files:
            return sorted(files)
    raise InputError(
        f"{folder}: has no images; name a recording (rgb.txt), or a folder of PNG or JPEG images "
        "of the board"
    )


def read_snapshots(files: list[SnapshotFiles]) -> Iterator[Snapshot | None]:
    """Yield one snapshot per entry, or None for an unreadable image, which is logged.

    Raises:
        InputError: The images differ in size, so they are not of one camera.
    """
    first: Snapshot | None = None
    for entry in files:
        try:
            color, depth = entry.color, entry.depth
            depth_raw = NO_DEPTH if depth is None else depth.read_depth()
            snapshot = Snapshot(color.name, color.stamp_s, color.read_color(), depth_raw)
        except UnreadableFrameError as error:
            _log.warning("an image is skipped: %s", error)
            yield None
            continue
        first = first or snapshot
        _check_size(snapshot, first)
        yield snapshot


def _check_size(snapshot: Snapshot, first: Snapshot) -> None:
    if snapshot.size != first.size or snapshot.depth_raw.shape != first.depth_raw.shape:
        raise InputError(
            f"{snapshot.name}: is {_format_size(snapshot)}, but {first.name} is "
            f"{_format_size(first)}; calibrate from images of one camera at one size"
        )


def _format_size(snapshot: Snapshot) -> str:
    color = "{}x{}".format(*snapshot.size)
    height, width = snapshot.depth_raw.shape
    return f"{color} (depth {width}x{height})" if width else color


def read_known_calibration(folder: Path, given: Path | None) -> CameraCalibration:
    """Read the camera file `given` or the folder's own; without one, depth is in millimeters.

    A board does not show its depth factor and its timing.

    Raises:
        InputError: The camera file is invalid.
    """
    try:
        return find_calibration(folder, given)
    except InputError:
        if given is not None or (folder / CAMERA_FILE_NAME).exists():
            raise
        return RAW_CALIBRATION


@dataclass(frozen=True)
class CollectedViews:
    """Views, what is known of their camera without a board, and gaps in their coverage."""

    views: list[BoardView]
    known: CameraCalibration
    gaps: list[CoverageGap]


def collect_from_folder(
    board: Board, folder: Path, camera_file: Path | None, with_depth: bool, terminal: Terminal
) -> CollectedViews:
    """Collect the views of a folder in which the board does not move and has a new pose.

    Args:
        camera_file: Camera file of the recording; None for its own.

    Raises:
        InputError: The folder is not usable, or no image shows the board.
    """
    files = list_snapshot_files(folder, with_depth)
    known = read_known_calibration(folder, camera_file)
    selector = ViewSelector(board)
    for number, snapshot in enumerate(read_snapshots(files), 1):
        if snapshot is not None:
            selector.process(snapshot)
        views = f"{len(selector.views)} views; image"
        terminal.progress(views, number, len(files))
    terminal.clear()
    if not selector.board_count:
        raise InputError(f"{folder}: {_no_board_message(board, files)}")
    return CollectedViews(
        selector.views, known, find_coverage_gaps(selector.views, selector.board_poses, with_depth)
    )


def _no_board_message(board: Board, files: list[SnapshotFiles]) -> str:
    """Return a message for images without the board, which may show another one."""
    count = len(files)
    sampled = files[:: max(1, count // MAX_SEARCHED_IMAGES)]
    suggestions = [
        board.suggest_other_board(snapshot.gray)
        for snapshot in read_snapshots(sampled)
        if snapshot is not None
    ]
    others = [option for option in suggestions if option]
    if others:
        return (
            f"none of the {count} images shows a {board.name}, but some show another board; use "
            f"--board {max(set(others), key=others.count)}"
        )
    return f"none of the {count} images shows a {board.name}; {BOARD_NOT_FOUND_HINT}"
