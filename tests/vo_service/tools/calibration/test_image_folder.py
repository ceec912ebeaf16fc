"""Snapshots from folders."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.core.errors import InputError
from vo_service.tools.calibration.image_folder import (
    list_snapshot_files,
    read_depth_units,
    read_snapshots,
)

CopyRecording = Callable[..., Path]


def write_image(file: Path, width: int = 32) -> None:
    file.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(file), np.full((24, width, 3), 7, np.uint8))


def test_a_recording_gives_its_images_as_they_are_stored(recording: Path) -> None:
    files = list_snapshot_files(recording, with_depth=True)
    first = next(read_snapshots(files))
    assert first is not None
    np.testing.assert_array_equal(first.color_bgr, cv2.imread(str(files[0].color)))
    depth = cv2.imread(str(files[0].depth), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(first.depth_raw, depth)


def test_a_recorded_lens_is_not_taken_out(copy_recording: CopyRecording) -> None:
    folder = copy_recording()
    text = (folder / "camera.toml").read_text()
    (folder / "camera.toml").write_text(text.replace("[0.0, 0.0,", "[0.3, -0.1,"))
    files = list_snapshot_files(folder, with_depth=False)
    (found, *_) = list(read_snapshots(files))
    assert found is not None
    np.testing.assert_array_equal(found.color_bgr, cv2.imread(str(files[0].color)))


def test_without_depth_a_list_of_color_images_will_do(copy_recording: CopyRecording) -> None:
    folder = copy_recording(lists=True)
    (folder / "depth.txt").unlink()
    files = list_snapshot_files(folder, with_depth=False)
    assert len(files) == 12
    assert all(found is not None and not found.depth_raw.size for found in read_snapshots(files))
    with pytest.raises(InputError, match=r"depth\.txt: no such file"):
        list_snapshot_files(folder, with_depth=True)


@pytest.mark.parametrize("place", ["", "rgb"])
def test_a_folder_of_photographs_will_do(tmp_path: Path, place: str) -> None:
    for name in ("b.JPG", "a.png"):
        write_image(tmp_path / place / name)
    (tmp_path / place / "notes.txt").write_text("taken on Monday\n")
    files = list_snapshot_files(tmp_path, with_depth=False)
    assert [file.color.name for file in files] == ["a.png", "b.JPG"]
    assert [file.stamp_s for file in files] == [0.0, 1.0]


def test_an_image_that_cannot_be_read_is_left_out_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_image(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(b"")
    found = list(read_snapshots(list_snapshot_files(tmp_path, with_depth=False)))
    assert [each is None for each in found] == [False, True]
    assert "b.png: is empty" in caplog.text


def test_images_of_two_sizes_are_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png")
    write_image(tmp_path / "b.png", width=40)
    with pytest.raises(InputError, match=r"b\.png: is 40x24, but .*a\.png is 32x24; calibrate"):
        list(read_snapshots(list_snapshot_files(tmp_path, with_depth=False)))


def test_nothing_to_see_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no images"):
        list_snapshot_files(tmp_path, with_depth=False)
    with pytest.raises(InputError, match="no such folder"):
        list_snapshot_files(tmp_path / "none", with_depth=False)


def test_the_unit_of_depth_is_the_recordings_or_millimetres(
    recording: Path, tmp_path: Path
) -> None:
    assert read_depth_units(recording, None).depth_factor == 5000.0
    assert read_depth_units(tmp_path, None).depth_factor == 1000.0
    (tmp_path / "camera.toml").write_text("schema = 1\n")
    with pytest.raises(InputError, match="key `width`: is missing"):
        read_depth_units(tmp_path, None)
