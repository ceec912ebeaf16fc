"""Conversion between formats loses nothing."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode
from rosbags.typesys import get_types_from_msg

from drivers.bag.bag_file import open_bag_file
from drivers.bag.bag_storage import BagStorage
from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import AccelerometerReading
from drivers.core import InputError, UserFacingError
from drivers.playback.recording_formats import open_recording
from drivers.recording.frame_recorder import FrameRecorder
from tests.drivers.bag.bag_maker import (
    FRAME,
    IMAGE,
    TF,
    BagWriter,
    color_image,
    depth_mm,
    open_writer,
    stamp_ns,
)
from tests.drivers.bag.test_bag import COLOR_TOPIC, DEPTH_TOPIC, make_bag, write_color, write_frame
from tests.drivers.tum.read_recording import assert_same, read_recording
from tests.vo_service.fakes import make_frame
from vo_service.tools.convert import OutputFormat, choose_format, convert

CopyRecording = Callable[..., Path]
DEPTH = "/camera/depth_registered/image_raw"
OUTPUTS = [("a.mcap", OutputFormat.MCAP), ("a.bag", OutputFormat.ROS1), ("a", OutputFormat.ROS2)]


def ignore_progress(count: int) -> None:
    pass


def convert_path(path: Path, output: Path, kind: OutputFormat | None = None) -> int:
    kind = kind or choose_format(output, None)
    return convert(open_recording(path), output, kind, ignore_progress)


def make_difficult(folder: Path) -> None:
    """Give a recording a distorted lens, timing, another depth unit, gravity and long stamps."""
    text = (folder / "camera.toml").read_text()
    lines = [
        line for line in text.splitlines()
        if not line.startswith(("distortion", "depth_factor", "readout", "depth_offset"))
    ]  # fmt: skip
    extra = ["distortion = [0.1, -0.2, 0.01, 0.0, 0.05]", "depth_factor = 3456.7"]
    extra += ["readout_s = 0.0291", "depth_offset_s = 0.0071", "readout_sigma_s = 0.002"]
    (folder / "camera.toml").write_text("\n".join([*lines, *extra]) + "\n")
    associations = (folder / "associations.txt").read_text().splitlines()
    rows = [line.split() for line in associations if not line.startswith("#")]
    rows = [[f"{a}000123456789", b, f"{c}000987654321", d] for a, b, c, d in rows]
    (folder / "associations.txt").write_text("\n".join(map(" ".join, rows)) + "\n")
    (folder / "accelerometer.txt").write_text(
        "".join(f"{float(row[0])!r} 0.1 9.{k:02} 0.3\n" for k, row in enumerate(rows))
    )


@pytest.mark.parametrize(("name", "kind"), OUTPUTS)
def test_a_folder_and_back_is_the_same_recording(
    copy_recording: CopyRecording, tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    folder = copy_recording()
    make_difficult(folder)
    count = convert_path(folder, tmp_path / "new" / name, kind)
    original = read_recording(folder)
    assert count == len(original)
    assert_same(read_recording(tmp_path / "new" / name), original)
    convert_path(tmp_path / "new" / name, tmp_path / "back")
    assert_same(read_recording(tmp_path / "back"), original)


def test_ground_truth_comes_along(copy_recording: CopyRecording, tmp_path: Path) -> None:
    folder = copy_recording()
    for name, kind in OUTPUTS:
        convert_path(folder, tmp_path / name, kind)
        ours, theirs = open_recording(tmp_path / name), open_recording(folder)
        assert ours.ground_truth is not None
        assert theirs.ground_truth is not None
        np.testing.assert_array_equal(ours.ground_truth.stamps_s, theirs.ground_truth.stamps_s)
        np.testing.assert_allclose(
            ours.ground_truth.T_world_camera, theirs.ground_truth.T_world_camera, atol=1e-9
        )


@pytest.mark.parametrize(("name", "kind"), OUTPUTS)
def test_depth_is_raw_for_viewers_and_small_in_bags(
    name: str, kind: OutputFormat, tmp_path: Path
) -> None:
    for is_raw in (False, True):
        with FrameRecorder(
            McapRecordingFile(tmp_path / f"{is_raw}.mcap", is_raw=is_raw)
        ) as recorder:
            recorder.write(make_frame(0))
        convert_path(tmp_path / f"{is_raw}.mcap", tmp_path / f"{is_raw}" / name, kind)
        with AnyReader([tmp_path / f"{is_raw}" / name]) as reader:
            depth = {each.topic for each in reader.connections if "depth" in each.topic}
        in_bag = {f"{DEPTH}/compressedDepth", "/camera/depth_registered/camera_info"}
        assert depth == ({DEPTH} if kind is OutputFormat.MCAP else in_bag)


def test_ros_2_plays_the_static_transform_of_a_bag_for_late_subscribers(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    convert_path(copy_recording(), tmp_path / "bag", OutputFormat.ROS2)
    with AnyReader([tmp_path / "bag"]) as reader:
        durability = {
            each.topic: each.ext.offered_qos_profiles[0].durability.name  # type: ignore[union-attr]
            for each in reader.connections
        }
    assert durability["/tf_static"] == "TRANSIENT_LOCAL"
    assert durability["/tf"] == "VOLATILE"


def test_gravity_beside_readings_comes_along(tmp_path: Path) -> None:
    readings = tuple(
        AccelerometerReading(1000.0 + 0.01 * k, (0.1 * k, -9.7, 0.0)) for k in range(3)
    )
    with FrameRecorder(McapRecordingFile(tmp_path / "a.mcap")) as recorder:
        for k in range(2):
            frame = make_frame(k, 1000.1 + k / 30)
            gravity = (0.1, 9.7, 0.3 + 0.1 * k)
            recorder.write(replace(frame, gravity_m_s2=gravity, accelerometer=readings))
    original = read_recording(tmp_path / "a.mcap")
    assert [frame.gravity_m_s2 for frame in original] == [(0.1, 9.7, 0.3), (0.1, 9.7, 0.4)]
    for name, kind in [*OUTPUTS, ("folder", OutputFormat.FOLDER)]:
        convert_path(tmp_path / "a.mcap", tmp_path / "new" / name, kind)
        assert_same(read_recording(tmp_path / "new" / name), original)
        if kind is not OutputFormat.FOLDER:
            assert read_recording(tmp_path / "new" / name)[0].accelerometer == readings


def test_files_in_millimeters_keep_their_bytes(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    folder = copy_recording()
    text = (folder / "camera.toml").read_text()
    (folder / "camera.toml").write_text(
        text.replace("depth_factor = 5000.0", "depth_factor = 1000.0")
    )
    convert_path(folder, tmp_path / "a.mcap")
    convert_path(tmp_path / "a.mcap", tmp_path / "back")
    files = [each for kind in ("rgb", "depth") for each in (folder / kind).iterdir()]
    assert len(files) == 24
    for file in files:
        copy = tmp_path / "back" / file.relative_to(folder)
        assert copy.read_bytes() == file.read_bytes()


@pytest.mark.parametrize(("name", "kind"), [*OUTPUTS, ("folder", OutputFormat.FOLDER)])
def test_registered_depth_of_half_the_size_is_written_enlarged(
    tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_color(bag, k)
        small = bag.maker.image(stamp_ns(k), depth_mm(k)[::2, ::2], "16UC1")
        bag.write(DEPTH_TOPIC, IMAGE, stamp_ns(k), small)

    path = make_bag(tmp_path / "half", fill)
    convert_path(path, tmp_path / name, kind)
    recording = open_recording(tmp_path / name)
    assert recording.depth_enlargement == 1
    recording.close()
    for ours, theirs in zip(read_recording(tmp_path / name), read_recording(path), strict=True):
        np.testing.assert_array_equal(ours.color_bgr, theirs.color_bgr)
        np.testing.assert_array_equal(ours.depth_raw, theirs.depth_raw)


def test_an_image_that_cannot_be_read_is_left_out_and_logged(
    copy_recording: CopyRecording, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = copy_recording()
    sorted((folder / "rgb").iterdir())[3].unlink()
    assert convert_path(folder, tmp_path / "a.mcap") == 11
    assert "is left out" in caplog.text


@pytest.mark.parametrize(("name", "kind"), [*OUTPUTS, ("folder", OutputFormat.FOLDER)])
def test_a_recording_that_is_not_complete_has_another_name(
    copy_recording: CopyRecording, tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    out, existed = tmp_path / "out" / name, set[bool]()
    convert(open_recording(copy_recording()), out, kind, lambda _: existed.add(out.exists()))
    assert (existed, out.exists()) == ({False}, True)


def test_what_a_killed_conversion_left_is_not_used(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    (tmp_path / "a.mcap.part").mkdir()
    with pytest.raises(InputError, match=r"a\.mcap\.part: a conversion runs or was killed"):
        convert_path(copy_recording(), tmp_path / "a.mcap")


def test_nothing_is_left_after_a_failure(copy_recording: CopyRecording, tmp_path: Path) -> None:
    def stop(count: int) -> None:
        if count == 3:
            raise KeyboardInterrupt

    folder = copy_recording()
    for name, kind in [*OUTPUTS, ("folder", OutputFormat.FOLDER)]:
        with pytest.raises(KeyboardInterrupt):
            convert(open_recording(folder), tmp_path / "out" / name, kind, stop)
        assert list((tmp_path / "out").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(UserFacingError, match="cannot be written: File exists"):
        convert_path(folder, tmp_path / "file" / "a.mcap")
    with pytest.raises(InputError, match="file: exists already"):
        convert_path(folder, tmp_path / "file")


def test_a_format_is_read_whatever_the_name(copy_recording: CopyRecording, tmp_path: Path) -> None:
    folder = copy_recording()
    for name, kind in (
        ("A.MCAP", None),
        ("A.BAG", None),
        ("folder.bag", OutputFormat.FOLDER),
        ("bag.mcap", OutputFormat.ROS2),
    ):
        path = tmp_path / name
        assert convert_path(folder, path, kind) == len(read_recording(path)) == 12


def test_a_name_that_could_not_be_read_is_refused(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"a.bag: the file name must end in .mcap"):
        choose_format(Path("a.bag"), "mcap")
    with pytest.raises(InputError, match=r"a: the file name must end in .bag"):
        choose_format(Path("a"), "ros1")
    for name in ("y.db3", "x.MP4", "x.tar.gz"):
        with pytest.raises(InputError, match=r"is the suffix of a file; name FILE.mcap"):
            choose_format(Path(name), None)
    for name in ("y.mcap", "y.bag"):
        with pytest.raises(InputError, match=r"is the suffix of a file; name FILE.mcap"):
            choose_format(Path(name), "ros2")
    for name in ("desk", "2026-11-26T10.30.05", "shelf_1.5m", ".hidden"):
        assert choose_format(Path(name), None) is OutputFormat.FOLDER
    folder = copy_recording()
    for name in ("a#b", "a%20b", "a?b"):
        with pytest.raises(InputError, match=r"a ROS 2 bag cannot have %, \? or # in its path"):
            convert_path(folder, tmp_path / name, OutputFormat.ROS2)
        assert list(tmp_path.glob("a*")) == []


def test_stamps_that_ros_cannot_hold_are_refused(
    copy_recording: CopyRecording, tmp_path: Path
) -> None:
    folder = copy_recording()
    associations = (folder / "associations.txt").read_text().splitlines()[1:]
    rows = [line.split() for line in associations]
    late = [f"{float(a) + 3e9:f} {b} {float(c) + 3e9:f} {d}\n" for a, b, c, d in rows]
    (folder / "associations.txt").write_text("".join(late))
    with pytest.raises(InputError, match="stamps of ROS are between 1970 and 2038; use a folder"):
        convert_path(folder, tmp_path / "a.mcap")


LEVEL = "my_msgs/msg/Level"


def write_with_poses(bag: BagWriter, k: int) -> None:
    """Write a frame as a robot records it: with transforms, a pose and a type of its own."""
    write_frame(bag, k)
    t, make = stamp_ns(k), bag.maker
    moved = make.transform(t, "odom", "base_link", (0.1 * k, 0.0, 1 / 3))
    bag.transforms("/tf", t + 1, TF, moved, make.transform(t, "base_link", FRAME, (0.0, 0.0, 1.0)))
    if k == 0:
        fixed = make.transform(t, "base_link", "imu_link", (0.1, 0.0, 0.0))
        bag.transforms("/tf_static", t, TF, fixed)
    bag.write("/pose", "geometry_msgs/msg/PoseStamped", t + 2, make.pose(t, (0.1, k, 0.3)))
    if LEVEL not in make.store.types:
        definition = "std_msgs/Header header\nfloat32[] volts"
        make.store.register(get_types_from_msg(definition, LEVEL))
    level = make.make(LEVEL, make.header(t, ""), np.array([12.5, k], np.float32))
    bag.write("/level", LEVEL, t + 3, level)


def encoded_messages(path: Path) -> list[tuple[str, int, bytes]]:
    with open_bag_file(BagStorage(path)) as bag:
        return sorted((m.topic, m.log_ns, m.data) for m in bag.messages(bag.types))


@pytest.mark.parametrize(("name", "kind"), OUTPUTS)
def test_poses_and_types_of_others_are_the_same_after_there_and_back(
    tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    make_bag(tmp_path / "robot", write_with_poses, "sqlite3")
    convert_path(tmp_path / "robot", tmp_path / "a.mcap")
    convert_path(tmp_path / "a.mcap", tmp_path / "there" / name, kind)
    convert_path(tmp_path / "there" / name, tmp_path / "back.mcap")
    messages = encoded_messages(tmp_path / "back.mcap")
    assert messages == encoded_messages(tmp_path / "a.mcap")
    originals = [m for m in encoded_messages(tmp_path / "robot") if not m[0].startswith("/camera")]
    assert {topic for topic, *_ in originals} == {"/tf", "/tf_static", "/pose", "/level"}
    assert [m for m in messages if m in originals] == originals


def test_the_messages_of_a_compressed_bag_are_written_plain(tmp_path: Path) -> None:
    make_bag(tmp_path / "plain", write_with_poses, "sqlite3")
    with open_writer(tmp_path / "small", "sqlite3", CompressionMode.MESSAGE) as bag:
        for k in range(4):
            write_with_poses(bag, k)
    for name in ("plain", "small"):
        convert_path(tmp_path / name, tmp_path / f"{name}.mcap")
    plain, small = ((tmp_path / f"{name}.mcap").read_bytes() for name in ("plain", "small"))
    assert small == plain


def test_a_transform_of_old_ros_has_the_new_type_in_ros_2(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        fixed = bag.maker.transform(stamp_ns(k), "world", FRAME, (0.1 * k, 0.0, 0.0))
        bag.transforms("/tf", stamp_ns(k), "tf/msg/tfMessage", fixed)

    convert_path(make_bag(tmp_path / "old.bag", fill, "bag"), tmp_path / "a.mcap")
    with open_bag_file(BagStorage(tmp_path / "a.mcap")) as bag:
        assert bag.types["/tf"] == TF
    truth = open_recording(tmp_path / "a.mcap").ground_truth
    assert truth is not None
    assert truth.T_world_camera[3, 0, 3] == pytest.approx(0.3)


def test_what_a_folder_has_no_place_for_is_named_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    make_bag(tmp_path / "robot", write_with_poses)
    convert_path(tmp_path / "robot", tmp_path / "folder")
    line = "left out, because a folder has no place for them: /level, /pose, /tf, /tf_static"
    assert caplog.text.count(line) == 1


def test_the_images_of_another_camera_come_along_and_do_not_confuse(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        t = stamp_ns(k)
        for topic in ("/other/color/image_raw", "/camera/rgb/image_raw"):
            bag.write(topic, IMAGE, t, bag.maker.image(t, color_image(k + 9), "bgr8"))

    path = make_bag(tmp_path / "two", fill)
    recording = open_recording(path, topics=(COLOR_TOPIC, DEPTH_TOPIC))
    convert(recording, tmp_path / "a.mcap", OutputFormat.MCAP, ignore_progress)
    np.testing.assert_array_equal(read_recording(tmp_path / "a.mcap")[3].color_bgr, color_image(3))
    with open_bag_file(BagStorage(tmp_path / "a.mcap")) as bag:
        assert "/other/color/image_raw" in bag.types


def test_a_message_that_is_not_of_its_type_is_left_out_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_with_poses(bag, k)
        if k:
            bag.writer.write(bag.connections["/pose"], stamp_ns(k), b"no pose")

    convert_path(make_bag(tmp_path / "robot", fill), tmp_path / "a.bag")
    assert "left out, because the output has no place for them: /pose\n" in caplog.text
    with open_bag_file(BagStorage(tmp_path / "a.bag")) as bag:
        assert sum(1 for _ in bag.messages(["/pose"])) == 4


@pytest.mark.parametrize(("name", "kind"), OUTPUTS)
def test_a_clock_that_was_set_back_stays_in_the_order_of_recording(
    tmp_path: Path, name: str, kind: OutputFormat
) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k, k if k < 20 else k - 30)

    make_bag(tmp_path / "jump", fill, count=40)
    convert_path(tmp_path / "jump", tmp_path / name, kind)
    assert_same(read_recording(tmp_path / name), read_recording(tmp_path / "jump"))
    with pytest.raises(InputError, match="its clock was set back, and a folder holds rising"):
        convert_path(tmp_path / name, tmp_path / "folder")
    assert not (tmp_path / "folder").exists()
