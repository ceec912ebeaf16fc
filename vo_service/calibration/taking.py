"""From a folder to the views that a calibration is made of."""

from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from vo_service.calibration.board import Board
from vo_service.calibration.folder import (
    DepthUnits,
    ImageFiles,
    depth_units,
    image_files,
    snapshots,
)
from vo_service.calibration.guidance import Lack, lacks
from vo_service.calibration.picking import ViewPicker
from vo_service.calibration.snapshot import View
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
