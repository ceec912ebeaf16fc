"""From a folder to the views that a calibration is made of."""

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

# So many images of a folder are searched for another board when none shows the one asked for.
MAX_SEARCHED_IMAGES = 12
BOARD_NOT_FOUND_HINT = (
    "see that --board counts its inner corners (chessboard) or squares (charuco), that the whole "
    "chessboard with its white edge is in the image, sharp, and not mirrored or too bright"
)


@dataclass(frozen=True)
class CollectedViews:
    """Views, what depth values mean in them, and what no view shows."""

    views: list[BoardView]
    units: DepthUnits
    gaps: list[CoverageGap]


def collect_from_folder(
    board: Board, folder: Path, camera_file: Path | None, with_depth: bool, terminal: Terminal
) -> CollectedViews:
    """Every view in the folder in which the board is still and stands differently.

    Raises InputError if the folder is no use or shows no such board.
    """
    files = list_snapshot_files(folder, with_depth)
    units = read_depth_units(folder, camera_file)
    picker = ViewSelector(board)
    for number, found in enumerate(read_snapshots(files), 1):
        if found is not None:
            picker.process(found)
        views = f"{len(picker.views)} views; image"
        terminal.progress(views, number, len(files))
    terminal.clear()
    if not picker.board_count:
        raise InputError(f"{folder}: {_no_board_message(board, files)}")
    return CollectedViews(
        picker.views, units, find_coverage_gaps(picker.views, picker.board_poses, with_depth)
    )


def _no_board_message(board: Board, files: list[SnapshotFiles]) -> str:
    """What to say of images without the board: perhaps they show another one."""
    count = len(files)
    spread = files[:: max(1, count // MAX_SEARCHED_IMAGES)]
    seen = [
        board.suggest_other_board(found.gray)
        for found in read_snapshots(spread)
        if found is not None
    ]
    others = [option for option in seen if option]
    if others:
        return (
            f"none of the {count} images shows a {board.name}, but some show another one: give "
            f"--board {max(set(others), key=others.count)}"
        )
    return f"none of the {count} images shows a {board.name}; {BOARD_NOT_FOUND_HINT}"
