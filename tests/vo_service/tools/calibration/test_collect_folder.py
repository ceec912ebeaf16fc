"""Snapshots from folders."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.core import InputError
from vo_service.tools.calibration.collect_folder import (
    list_snapshot_files,
    read_known_calibration,
    read_snapshots,
)

CopyRecording = Callable[..., Path]


def write_image(file: Path, width: int = 32) -> None:
    file.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(file), np.full((24, width, 3), 7, np.uint8))


def test_a_recording_gives_its_stored_images_which_are_not_undistorted(
    copy_recording: CopyRecording,
) -> None:
    folder = copy_recording()
    text = (folder / "camera.toml").read_text()
    (folder / "camera.toml").write_text(text.replace("[0.0, 0.0,", "[0.3, -0.1,"))
    files = list_snapshot_files(folder, with_depth=True)
    first = next(read_snapshots(files))
    assert first is not None
    np.testing.assert_array_equal(first.color_bgr, cv2.imread(str(files[0].color.file)))
    assert files[0].depth is not None
    depth = cv2.imread(str(files[0].depth.file), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(first.depth_raw, depth)


def test_without_depth_a_list_of_color_images_is_enough(copy_recording: CopyRecording) -> None:
    folder = copy_recording(lists=True)
    (folder / "depth.txt").unlink()
    files = list_snapshot_files(folder, with_depth=False)
    assert len(files) == 12
    assert all(
        snapshot is not None and not snapshot.depth_raw.size for snapshot in read_snapshots(files)
    )
    with pytest.raises(InputError, match=r"depth\.txt: no such file"):
        list_snapshot_files(folder, with_depth=True)


@pytest.mark.parametrize("subfolder", ["", "rgb"])
def test_a_folder_of_photographs_is_enough(tmp_path: Path, subfolder: str) -> None:
    for name in ("b.JPG", "a.png"):
        write_image(tmp_path / subfolder / name)
    (tmp_path / subfolder / "notes.txt").write_text("taken on Monday\n")
    files = list_snapshot_files(tmp_path, with_depth=False)
    assert [file.color.file.name for file in files] == ["a.png", "b.JPG"]
    assert [file.color.stamp_s for file in files] == [0.0, 1.0]


def test_an_unreadable_image_is_skipped_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_image(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(b"")
    snapshots = list(read_snapshots(list_snapshot_files(tmp_path, with_depth=False)))
    assert [snapshot is None for snapshot in snapshots] == [False, True]
    assert "b.png: is empty" in caplog.text


def test_images_of_two_sizes_are_rejected(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    write_image(tmp_path / "b.png", width=40)
    with pytest.raises(InputError, match=r"b\.png: is 40x24, but .*a\.png is 32x24; calibrate"):
        list(read_snapshots(list_snapshot_files(tmp_path, with_depth=False)))


def test_the_depth_unit_is_the_recordings_or_millimeters(recording: Path, tmp_path: Path) -> None:
    assert read_known_calibration(recording, None).depth_factor == 5000.0
    assert read_known_calibration(tmp_path, None).depth_factor == 1000.0
    (tmp_path / "camera.toml").write_text("schema = 1\n")
    with pytest.raises(InputError, match="key `width`: is missing"):
        read_known_calibration(tmp_path, None)
