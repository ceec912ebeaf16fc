"""Bags in several files, compressed bags, and bags that were not closed."""

import gc
import tempfile
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionMode

from drivers.playback.camera import RecordingCamera
from drivers.playback.recording_formats import open_recording
from tests.drivers.bag.bag_maker import color_image, depth_mm, open_writer, stamp_ns
from tests.drivers.bag.test_bag import complaint, make_bag, write_frame
from tests.full_disk import limit_file_size

ROS2_KINDS = ("sqlite3", "mcap")
ENDINGS = {"bag": ".bag", "sqlite3": ".db3", "mcap": ".mcap"}
PART_FRAMES = 3
METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths: [{}]
"""


def make_compressed(path: Path, kind: str, mode: CompressionMode) -> Path:
    with open_writer(path, kind, mode) as bag:
        for k in range(4):
            write_frame(bag, k)
    return path


def make_split(folder: Path, kind: str, names: tuple[str, ...] = ("a_0", "a_1")) -> list[Path]:
    """Make the parts of a recording, without metadata."""
    folder.mkdir()
    files = []
    for part, name in enumerate(names):
        made = folder.parent / f"part-{part}{'.bag' if kind == 'bag' else ''}"
        with open_writer(made, kind) as bag:
            for k in range(PART_FRAMES * part, PART_FRAMES * (part + 1)):
                write_frame(bag, k)
        (file,) = [made] if kind == "bag" else [f for f in made.iterdir() if f.suffix != ".yaml"]
        files.append(file.rename(folder / f"{name}{ENDINGS[kind]}"))
    return files


def check_frames(path: Path, numbers: range) -> None:
    """Check that a recording has these frames, bit for bit."""
    with RecordingCamera(path) as camera:
        frames = list(camera)
    assert [frame.stamp_s for frame in frames] == [float(f"{stamp_ns(k)}e-9") for k in numbers]
    for k, frame in zip(numbers, frames, strict=True):
        np.testing.assert_array_equal(frame.color_bgr, color_image(k))
        np.testing.assert_array_equal(frame.depth_raw, depth_mm(k))


@pytest.mark.parametrize("kind", ROS2_KINDS)
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_compressed_bag_is_read_by_its_folder_and_by_its_file(
    tmp_path: Path, kind: str, mode: CompressionMode
) -> None:
    folder = make_compressed(tmp_path / "a", kind, mode)
    (file,) = [each for each in folder.iterdir() if each.name != "metadata.yaml"]
    assert (file.suffix == ".zstd") == (mode is CompressionMode.FILE)
    check_frames(folder, range(4))
    check_frames(file, range(4))
    (folder / "metadata.yaml").unlink()
    check_frames(folder, range(4))


def test_decompressed_files_are_removed_with_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_compressed(tmp_path / "a", "sqlite3", CompressionMode.FILE)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    recording = open_recording(folder)
    assert len(list((tmp_path / "tmp").glob("*/a.db3"))) == 1
    recording.close()
    del recording
    gc.collect()
    assert not list((tmp_path / "tmp").iterdir())


def test_a_compressed_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    (file,) = make_compressed(tmp_path / "a", "mcap", CompressionMode.FILE).glob("*.zstd")
    file.write_bytes(file.read_bytes()[:-100])
    message = complaint(file)
    assert message.startswith("BAG: cannot be decompressed: ")
    assert message.endswith("; copy it again")


def test_a_full_disk_for_decompressed_files_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_compressed(tmp_path / "a", "mcap", CompressionMode.FILE)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with limit_file_size(10_000):
        message = complaint(folder)
    assert message == (
        f"BAG/a.mcap.zstd: {tmp_path} has no room for it without compression; set TMPDIR to a "
        "folder that has"
    )
    gc.collect()
    assert not list(tmp_path.glob("kinect-vo-bag-*"))


def test_a_bag_that_was_decompressed_by_hand_is_read(tmp_path: Path) -> None:
    folder = make_compressed(tmp_path / "a", "sqlite3", CompressionMode.FILE)
    (file,) = folder.glob("*.zstd")
    file.with_suffix("").write_bytes(zstd.decompress(file.read_bytes()))
    file.write_bytes(b"is not read")
    check_frames(folder, range(4))


@pytest.mark.parametrize("kind", ENDINGS)
def test_the_folder_of_a_split_bag_is_the_whole_and_each_file_a_part(
    tmp_path: Path, kind: str
) -> None:
    first, second = make_split(tmp_path / "a", kind)
    check_frames(tmp_path / "a", range(6))
    check_frames(first, range(3))
    check_frames(second, range(3, 6))


@pytest.mark.parametrize("kind", ENDINGS)
def test_files_joined_by_commas_are_one_recording(tmp_path: Path, kind: str) -> None:
    first, second = make_split(tmp_path / "a", kind, ("desk", "kitchen"))
    check_frames(Path(f"{first},{second}"), range(6))
    assert open_recording(Path(f"{first},{second}")).summary.startswith(
        f"{first},{second}: 2 files, color "
    )
    gone = tmp_path / "gone.bag"
    assert complaint(Path(f"{first},{gone}")).endswith("gone.bag: no such file; check the path")


def test_files_of_several_formats_are_not_joined(tmp_path: Path) -> None:
    (first,), (second,) = (make_split(tmp_path / k, k, ("a_0",)) for k in ("bag", "mcap"))
    assert complaint(Path(f"{first},{second}")) == (
        "BAG: its files are of several formats; name one file"
    )


def test_frames_of_a_split_bag_are_read_in_any_order(tmp_path: Path) -> None:
    make_split(tmp_path / "a", "mcap")
    recording = open_recording(tmp_path / "a")
    for k in (5, 0, 4, 1):
        np.testing.assert_array_equal(recording.frames.pairs[k].color.read_color(), color_image(k))
    recording.close()


def test_parts_are_ordered_by_their_numbers(tmp_path: Path) -> None:
    make_split(tmp_path / "a", "bag", ("2024-05-01-09-58-10_9", "2024-05-01-10-02-11_10"))
    check_frames(tmp_path / "a", range(6))


def test_metadata_gives_the_order_of_the_files(tmp_path: Path) -> None:
    first, second = make_split(tmp_path / "a", "sqlite3", ("morning", "evening"))
    (tmp_path / "a/metadata.yaml").write_text(METADATA.format(f"{first.name}, {second.name}"))
    check_frames(tmp_path / "a", range(6))


@pytest.mark.parametrize("text", ["", "rosbag2_bagfile_information:\n  version: 9\n", "{a: [\0"])
def test_a_bag_whose_metadata_were_not_written_is_read(tmp_path: Path, text: str) -> None:
    make_split(tmp_path / "a", "sqlite3")
    (tmp_path / "a/metadata.yaml").write_text(text)
    check_frames(tmp_path / "a", range(6))


def test_a_file_of_the_metadata_that_is_missing_is_named(tmp_path: Path) -> None:
    first, second = make_split(tmp_path / "a", "mcap")
    (tmp_path / "a/metadata.yaml").write_text(METADATA.format(f"{first.name}, {second.name}"))
    second.unlink()
    assert complaint(tmp_path / "a") == (
        "BAG/a_1.mcap: no such file, but metadata.yaml lists it; restore it, or name one of the "
        "other files"
    )


@pytest.mark.parametrize("names", [("desk", "kitchen"), ("desk_0", "kitchen_1"), ("a_0", "a_00")])
def test_recordings_that_only_share_a_folder_are_not_joined(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    make_split(tmp_path / "a", "bag", names)
    message = complaint(tmp_path / "a")
    assert f"BAG: holds {names[0]}.bag, {names[1]}.bag, which are not the numbered" in message
    assert message.endswith("name one file")


def test_an_empty_bag_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").touch()
    assert complaint(tmp_path).startswith("BAG: holds no files of messages")


def test_the_last_part_of_a_killed_recorder_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    _, second = make_split(tmp_path / "a", "mcap")
    second.write_bytes(second.read_bytes()[:20])
    check_frames(tmp_path / "a", range(3))
    assert "the file is cut off" in open_recording(tmp_path / "a").summary


def test_a_ros1_bag_that_is_still_active_needs_an_index(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a.bag", kind="bag").rename(tmp_path / "a.bag.active")
    check_frames(path, range(4))  # as after `rosbag reindex`
    data = path.read_bytes()
    position = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[:position] + bytes(8) + data[position + 8 :])
    assert complaint(path) == (
        "BAG: the bag has no usable index, because it was not closed or cut off; "
        "run `rosbag reindex` on it"
    )
