"""One Kinect before one board, photographed in many places: the same for all tests."""

import hashlib
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from tests.shared_fixture import make_once
from tests.vo_service.tools.calibration.rendered_boards import random_board_poses, take_snapshots
from vo_service.tools.calibration.board import BoardCorners, BoardLayout, GrayImage
from vo_service.tools.calibration.chessboard import Chessboard
from vo_service.tools.calibration.snapshot import Snapshot

# On A3.
BOARD = Chessboard(BoardLayout(10, 7, 0.035))
VIEWS = 26
# Boards of this seed reach every part of the image, and are tilted every way.
SEED = 4
FILE = "snapshots.pickle"


def load_snapshots(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Color and depth; rendered once."""
    folder = make_once(tmp_path_factory, "photographs", _render)
    found: list[Snapshot] = pickle.loads((folder / FILE).read_bytes())
    return found


def _render(folder: Path) -> None:
    found = take_snapshots(BOARD, random_board_poses(BOARD, VIEWS, SEED), with_depth=True)
    (folder / FILE).write_bytes(pickle.dumps(found))


@contextmanager
def each_image_is_searched_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Most tests see the same images, and what takes the time is to find the board in them.

    In the photographs it is found once for all of pytest's processes.
    """
    find = Chessboard.find_corners
    known: dict[tuple[int, int, bytes], BoardCorners] = {}

    def remembered(board: Chessboard, gray: GrayImage) -> BoardCorners:
        image = hashlib.sha256(gray.tobytes()).digest()
        key = board.layout.columns, board.layout.rows, image
        if key not in known:
            known[key] = find(board, gray)
        found = known[key]
        points_m = board.layout.inner_corners_m  # whatever the side of its squares
        return replace(found, points_m=points_m) if len(found.pixels) else found

    def search(folder: Path) -> None:
        for photograph in load_snapshots(tmp_path_factory):
            remembered(BOARD, photograph.gray)
        (folder / FILE).write_bytes(pickle.dumps(known))

    folder = make_once(tmp_path_factory, "searched", search)
    known |= pickle.loads((folder / FILE).read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Chessboard, "find_corners", remembered)
        yield


def record_snapshots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The photographs as a recording of unregistered depth in millimetres; leave it as it is."""
    photographs = load_snapshots(tmp_path_factory)

    def record(folder: Path) -> None:
        for name in ("rgb", "depth"):
            (folder / name).mkdir()
        lines = []
        for each in photographs:
            file = f"{each.stamp_s:.6f}.png"
            assert cv2.imwrite(str(folder / "rgb" / file), each.color_bgr)
            assert cv2.imwrite(str(folder / "depth" / file), each.depth_raw)
            lines.append(f"{each.stamp_s} rgb/{file} {each.stamp_s} depth/{file}\n")
        (folder / "associations.txt").write_text("".join(lines))

    return make_once(tmp_path_factory, "boards", record)
