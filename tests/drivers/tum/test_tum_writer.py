import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.calibration import format_calibration, read_calibration
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core import InputError, UserFacingError
from drivers.recording.frame_encoding import FrameStamps, format_stamp
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.image_encoding import ColorFormat
from drivers.tum.writer import TumFolder
from tests.drivers.conftest import make_frame
from tests.drivers.tum.read_recording import read_recording

FolderMaker = Callable[..., Path]


def test_the_depth_offset_is_in_the_stamps_and_counted_once(
    make_folder: FolderMaker, tmp_path: Path
) -> None:
    folder = make_folder(skew_s=0.005)
    late = dataclasses.replace(read_calibration(folder / "camera.toml"), depth_offset_s=0.0071)
    (folder / "camera.toml").write_text(format_calibration(late))
    first = read_recording(folder)
    with FrameRecorder(TumFolder(tmp_path / "copy")) as writer:
        for frame in first:
            writer.write(frame)
    assert first[0].skew_s == pytest.approx(0.0121)
    assert read_calibration(tmp_path / "copy/camera.toml").depth_offset_s == 0.0
    (read, *_) = read_recording(tmp_path / "copy")
    assert (read.stamp_s, read.skew_s) == (first[0].stamp_s, first[0].skew_s)


@given(st.floats(0, 4e9), st.floats(-0.05, 0.05))
def test_any_stamp_and_skew_can_be_written_exactly(stamp_s: float, skew_s: float) -> None:
    frame = RgbdFrame(
        0, stamp_s, 0.0, np.empty(0, np.uint8), np.empty(0, np.uint16), 1.0,
        PinholeCamera(1, 1, 1, 1, 0, 0), skew_s=skew_s,
    )  # fmt: skip
    stamps = FrameStamps.from_frame(frame)
    assert float(format_stamp(stamps.color)) == stamp_s
    assert float(stamps.depth - stamps.color) == pytest.approx(skew_s, abs=1e-15)
    assert "e" not in format_stamp(stamps.depth).lower()


def test_the_layout_is_that_of_the_benchmark(tmp_path: Path) -> None:
    with FrameRecorder(TumFolder(tmp_path / "new/place")) as writer:
        writer.write(make_frame(0, readout_s=0.02))
        writer.write(make_frame(1, readout_s=0.02, stamp_s=1000.5))
    folder = tmp_path / "new/place"
    assert (folder / "associations.txt").read_text() == (
        "# timestamp rgb timestamp depth\n"
        "1000.000000 rgb/1000.000000.png 1000.010000 depth/1000.010000.png\n"
        "1000.500000 rgb/1000.500000.png 1000.510000 depth/1000.510000.png\n"
    )
    assert (folder / "rgb.txt").read_text().splitlines()[1] == "1000.000000 rgb/1000.000000.png"
    assert (folder / "depth.txt").read_text().splitlines()[2] == "1000.510000 depth/1000.510000.png"
    camera = read_calibration(folder / "camera.toml")
    assert camera.pinhole == make_frame(0).camera
    assert (camera.distortion, camera.readout_s) == ((0.0,) * 5, 0.02)
    assert not list(folder.rglob(".*"))


def test_jpeg_color_is_smaller_and_close(tmp_path: Path) -> None:
    frame = make_frame(0)
    with FrameRecorder(TumFolder(tmp_path / "jpg", color_format=ColorFormat.JPEG)) as writer:
        writer.write(frame)
    (read,) = read_recording(tmp_path / "jpg")
    assert (tmp_path / "jpg/rgb/1000.000000.jpg").is_file()
    assert np.abs(read.color_bgr.astype(int) - frame.color_bgr).mean() < 3
    np.testing.assert_array_equal(read.depth_raw, frame.depth_raw)


def test_a_folder_that_is_not_empty_is_rejected(make_folder: FolderMaker) -> None:
    folder = make_folder(count=1)
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match="is not empty; name a new folder"):
        FrameRecorder(TumFolder(folder))
    assert sorted(folder.rglob("*")) == before


def test_a_deleted_folder_is_one_clear_error(tmp_path: Path) -> None:
    writer = FrameRecorder(TumFolder(tmp_path / "r"))
    for seq in range(9):
        writer.write(make_frame(seq))
    (tmp_path / "r").rename(tmp_path / "elsewhere")
    more = [make_frame(seq) for seq in range(9, 20)]
    reasons = "No such file|it was removed or renamed"  # the image or its line comes first
    with pytest.raises(UserFacingError, match=f"r: cannot be written: ({reasons})"):
        list(map(writer.write, more))
    with pytest.raises(UserFacingError):
        writer.write(make_frame(99))
    writer.close()
    writer.close()
    assert len(read_recording(tmp_path / "elsewhere")) == writer.written
