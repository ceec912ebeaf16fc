"""Snapshots of one board by one Kinect, shared by all tests."""

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
from vo_service.tools.calibration import color_camera, depth_camera
from vo_service.tools.calibration.board import BoardCorners, BoardLayout, GrayImage
from vo_service.tools.calibration.chessboards import Chessboard
from vo_service.tools.calibration.snapshot import Snapshot

# On A3.
BOARD = Chessboard(BoardLayout(10, 7, 0.035))
VIEWS = 23
# With this seed, the boards reach every part of the image and have all tilts.
SEED = 4
FILE = "snapshots.pickle"


def load_snapshots(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Load snapshots with color and depth, which are rendered once."""
    folder = make_once(tmp_path_factory, "snapshots", _render)
    snapshots: list[Snapshot] = pickle.loads((folder / FILE).read_bytes())
    return snapshots


def _render(folder: Path) -> None:
    snapshots = take_snapshots(BOARD, random_board_poses(BOARD, VIEWS, SEED), with_depth=True)
    (folder / FILE).write_bytes(pickle.dumps(snapshots))


@contextmanager
def each_image_is_searched_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Cache the detected corners of each image, because detection takes most of the tests' time.

    In the snapshots, corners are detected once for all processes of pytest.
    """
    detect = Chessboard.find_corners
    cache: dict[tuple[int, int, bytes], BoardCorners] = {}

    def find_cached(board: Chessboard, gray: GrayImage) -> BoardCorners:
        image = hashlib.sha256(gray.tobytes()).digest()
        key = board.layout.columns, board.layout.rows, image
        if key not in cache:
            cache[key] = detect(board, gray)
        corners = cache[key]
        points_m = board.layout.inner_corners_m  # the side of the squares may differ
        return replace(corners, points_m=points_m) if len(corners.pixels) else corners

    def search(folder: Path) -> None:
        for snapshot in load_snapshots(tmp_path_factory):
            find_cached(BOARD, snapshot.gray)
        (folder / FILE).write_bytes(pickle.dumps(cache))

    folder = make_once(tmp_path_factory, "searched", search)
    cache |= pickle.loads((folder / FILE).read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Chessboard, "find_corners", find_cached)
        yield


def set_jackknife_groups(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Set the number of fits of standard deviations, which take most of the time."""
    for module in (color_camera, depth_camera):
        monkeypatch.setattr(module, "JACKKNIFE_GROUPS", count)


def record_snapshots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record the snapshots with unregistered depth in millimeters; tests must not change it."""
    snapshots = load_snapshots(tmp_path_factory)

    def record(folder: Path) -> None:
        for name in ("rgb", "depth"):
            (folder / name).mkdir()
        lines = []
        for snapshot in snapshots:
            file = f"{snapshot.stamp_s:.6f}.png"
            assert cv2.imwrite(str(folder / "rgb" / file), snapshot.color_bgr)
            assert cv2.imwrite(str(folder / "depth" / file), snapshot.depth_raw)
            lines.append(f"{snapshot.stamp_s} rgb/{file} {snapshot.stamp_s} depth/{file}\n")
        (folder / "associations.txt").write_text("".join(lines))

    return make_once(tmp_path_factory, "boards", record)
