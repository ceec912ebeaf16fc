"""Collection of views from a folder."""

from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import InputError
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.coverage import CoverageGap, find_coverage_gaps
from vo_service.tools.calibration.image_folder import (
    DepthUnits,
    SnapshotFiles,
    list_snapshot_files,
    read_depth_units,
    read_snapshots,
)
from vo_service.tools.calibration.snapshot import BoardView
from vo_service.tools.calibration.view_selection import ViewSelector

# If no image shows the requested board, this many images are searched for another one.
MAX_SEARCHED_IMAGES = 12
BOARD_NOT_FOUND_HINT = (
    "check that --board counts inner corners (chessboard) or squares (charuco); the whole "
    "chessboard with its white edge must be in the image, sharp, not mirrored and not too bright"
)


@dataclass(frozen=True)
class CollectedViews:
    """Views, their depth units, and gaps in their coverage."""

    views: list[BoardView]
    units: DepthUnits
    gaps: list[CoverageGap]


def collect_from_folder(
    board: Board, folder: Path, camera_file: Path | None, with_depth: bool, terminal: Terminal
) -> CollectedViews:
    """Collect the views of a folder in which the board does not move and has a new pose.

    Args:
        board: The board.
        folder: Recording or folder of images.
        camera_file: Camera file of the recording; None for its own.
        with_depth: Whether to read depth images.
        terminal: Shows the progress.

    Raises:
        InputError: The folder is not usable, or no image shows the board.
    """
    files = list_snapshot_files(folder, with_depth)
    units = read_depth_units(folder, camera_file)
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
        selector.views, units, find_coverage_gaps(selector.views, selector.board_poses, with_depth)
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
