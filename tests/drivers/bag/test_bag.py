"""Bags of ROS 1 and ROS 2, as robots record them."""

import dataclasses
import sqlite3
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import mcap.writer
import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from drivers.bag.image_messages import RVL_SIZE
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.playback.camera import RecordingCamera, playback_offsets_s
from drivers.playback.recording_formats import open_recording
from drivers.ros_messages.sensors import COMPRESSED_DEPTH_HEADER
from tests.drivers.bag.bag_maker import (
    COMPRESSED,
    FRAME,
    IMAGE,
    INFO,
    SIZE,
    TF,
    BagWriter,
    color_image,
    depth_mm,
    open_writer,
    stamp_ns,
)
from tests.drivers.bag.test_rvl import encode_rvl

COLOR_TOPIC, DEPTH_TOPIC = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO_TOPIC = "/camera/color/camera_info"
KINDS = ("bag", "sqlite3", "mcap")
Fill = Callable[[BagWriter, int], None]
Info = Mapping[str, Any]
NO_CHANGE: Info = {}


def write_color(bag: BagWriter, k: int, stamp: int | None = None, info: Info = NO_CHANGE) -> None:
    """Write color at the log time of the k-th frame, with the stamp of another."""
    log_ns, t = stamp_ns(k), stamp_ns(k if stamp is None else stamp)
    bag.write(INFO_TOPIC, INFO, log_ns, dataclasses.replace(bag.maker.info(t), **info))
    bag.write(COLOR_TOPIC, IMAGE, log_ns, bag.maker.image(t, color_image(k), "bgr8"))


def write_frame(
    bag: BagWriter,
    k: int,
    stamp: int | None = None,
    info: Info = NO_CHANGE,
    depth: NDArray[Any] | None = None,
    encoding: str = "16UC1",
) -> None:
    """Write a frame, with changes of the color camera's information, or with another depth."""
    write_color(bag, k, stamp, info)
    t = stamp_ns(k if stamp is None else stamp)
    image = depth_mm(k) if depth is None else depth
    bag.write(DEPTH_TOPIC, IMAGE, stamp_ns(k), bag.maker.image(t, image, encoding))


def first_frame(folder: Path, fill: Fill) -> RgbdFrame:
    """The first frame of a bag."""
    with RecordingCamera(make_bag(folder / "a", fill, count=1)) as camera:
        return next(iter(camera))


def make_bag(path: Path, fill: Fill = write_frame, kind: str = "mcap", count: int = 4) -> Path:
    with open_writer(path, kind) as bag:
        for k in range(count):
            fill(bag, k)
    return path


def complaint(path: Path, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        open_recording(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(str(path), "BAG")


@pytest.mark.parametrize("kind", KINDS)
def test_raw_images_are_read_bit_for_bit(tmp_path: Path, kind: str) -> None:
    path = make_bag(tmp_path / ("a.bag" if kind == "bag" else "a"), kind=kind)
    with RecordingCamera(path) as camera:
        frames = list(camera)
    assert camera.name == f"bag:{path}"
    assert [frame.depth_factor for frame in frames] == [1000.0] * 4
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.color_bgr, color_image(k))
        np.testing.assert_array_equal(frame.depth_raw, depth_mm(k))


def test_an_old_ros2_bag_without_definitions_is_read(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a", kind="sqlite3")
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    assert len(open_recording(path).frames.pairs) == 4


def test_frames_are_read_in_any_order(tmp_path: Path) -> None:
    for kind in KINDS:
        path = make_bag(tmp_path / ("b.bag" if kind == "bag" else kind), kind=kind, count=12)
        recording = open_recording(path)
        for k in (11, 3, 3, 7, 0):
            color, depth = recording.frames.pairs[k].load(SIZE, SIZE)
            np.testing.assert_array_equal(color, color_image(k))
            np.testing.assert_array_equal(depth, depth_mm(k))
        recording.close()


@pytest.mark.parametrize(
    ("form", "kind"), [("jpeg", ".jpg"), ("bgr8; jpeg compressed bgr8", ".jpg"), ("png", ".png")]
)
def test_compressed_images_are_read(tmp_path: Path, form: str, kind: str) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        t = stamp_ns(k)
        color = cv2.imencode(kind, color_image(k))[1].tobytes()
        png = COMPRESSED_DEPTH_HEADER.pack(0, 0, 0) + cv2.imencode(".png", depth_mm(k))[1].tobytes()
        depth = bag.maker.compressed(t, png, "16UC1; compressedDepth png")
        bag.write(INFO_TOPIC, INFO, t, bag.maker.info(t))
        bag.write(f"{COLOR_TOPIC}/compressed", COMPRESSED, t, bag.maker.compressed(t, color, form))
        bag.write(f"{DEPTH_TOPIC}/compressedDepth", COMPRESSED, t, depth)

    frame = first_frame(tmp_path, fill)
    np.testing.assert_array_equal(frame.depth_raw, depth_mm(0))
    assert np.abs(frame.color_bgr.astype(int) - color_image(0)).mean() < 3


def test_compressed_depth_in_meters_is_inverted(tmp_path: Path) -> None:
    a, b = 20.0, 0.5

    def fill(bag: BagWriter, k: int) -> None:
        write_color(bag, k)
        inverse = np.full(SIZE[::-1], 0, np.uint16)
        inverse[8:] = round(a / 2.0 + b)  # 2 m
        png = COMPRESSED_DEPTH_HEADER.pack(0, a, b) + cv2.imencode(".png", inverse)[1].tobytes()
        message = bag.maker.compressed(stamp_ns(k), png, "32FC1; compressedDepth png")
        bag.write(f"{DEPTH_TOPIC}/compressedDepth", COMPRESSED, stamp_ns(k), message)

    depth_m = first_frame(tmp_path, fill).depth_m
    assert not depth_m[:8].any()
    np.testing.assert_allclose(depth_m[8:], a / (round(a / 2.0 + b) - b), atol=2e-4)


def test_depth_compressed_as_rvl_is_read(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_color(bag, k)
        rvl = RVL_SIZE.pack(*SIZE) + encode_rvl(depth_mm(k))
        data = COMPRESSED_DEPTH_HEADER.pack(0, 0, 0) + rvl[: -4 if k == 2 else None]
        message = bag.maker.compressed(stamp_ns(k), data, "16UC1; compressedDepth rvl")
        bag.write(f"{DEPTH_TOPIC}/compressedDepth", COMPRESSED, stamp_ns(k), message)

    with RecordingCamera(make_bag(tmp_path / "a", fill)) as camera:
        frames = list(camera)
        assert camera.counters.skipped == 1
    assert [frame.seq for frame in frames] == [0, 1, 3]
    np.testing.assert_array_equal(frames[2].depth_raw, depth_mm(3))


def test_lens_distortion_is_undone(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        t = stamp_ns(k)
        bag.write("/other/camera_info", INFO, t, bag.maker.info(t, distortion=(0.3, 0, 0, 0, 0.0)))
        bag.write("/other/image_raw", IMAGE, t, bag.maker.image(t, color_image(k), "bgr8"))

    path = make_bag(tmp_path / "a", fill)
    assert open_recording(path).calibration.distortion == (0.0,) * 5
    named = open_recording(path, topics=("/other/image_raw", DEPTH_TOPIC))
    assert named.calibration.distortion == (0.3, 0.0, 0.0, 0.0, 0.0)


def write_unregistered(bag: BagWriter, k: int) -> None:
    write_color(bag, k)
    t, depth_frame = stamp_ns(k), "depth_optical"
    depth = np.full(SIZE[::-1], 1000, np.uint16)
    bag.write("/camera/depth/camera_info", INFO, t, bag.maker.info(t, frame=depth_frame))
    message = bag.maker.image(t, depth, "16UC1", depth_frame)
    bag.write("/camera/depth/image_raw", IMAGE, t, message)


def test_depth_of_its_own_camera_is_registered(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_unregistered(bag, k)
        move = bag.maker.transform(stamp_ns(k), FRAME, "depth_optical", (0.1, 0.0, 0.2))
        bag.transforms("/tf_static", stamp_ns(k), TF, move)

    depth = first_frame(tmp_path, fill).depth_raw
    assert set(np.unique(depth)) == {0, 1200}
    assert not depth[:, :5].any()  # nothing is seen left of the depth camera's view


def test_depth_of_its_own_camera_may_have_another_size(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_color(bag, k)
        t, make, frame = stamp_ns(k), bag.maker, "depth_optical"
        info = make.info(t, focal_px=30.0, frame=frame, size=(32, 24))
        bag.write("/camera/depth/camera_info", INFO, t, info)
        depth = make.image(t, np.full((24, 32), 1000, np.uint16), "16UC1", frame)
        bag.write("/camera/depth/image_raw", IMAGE, t, depth)
        bag.transforms("/tf_static", t, TF, make.transform(t, FRAME, frame, (0.0, 0.0, 0.0)))

    depth = first_frame(tmp_path, fill).depth_raw
    assert depth.shape == SIZE[::-1]
    assert np.median(depth) == 1000


def test_depth_that_cannot_be_registered_is_refused(tmp_path: Path) -> None:
    assert "no transform between them" in complaint(make_bag(tmp_path / "a", write_unregistered))


def test_gravity_comes_from_the_imu(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        t, make = stamp_ns(k), bag.maker
        # Optical axes in an IMU with x forward, y left, z up.
        turn = make.transform(t, "imu", FRAME, (0.0, 0.0, 0.0), (-0.5, 0.5, -0.5, 0.5))
        bag.transforms("/tf_static", t, TF, turn)
        bag.write("/imu/data", "sensor_msgs/msg/Imu", t, make.imu(t, (0.0, 0.0, 9.81), "imu"))

    gravity = first_frame(tmp_path, fill).gravity_m_s2
    assert gravity is not None
    np.testing.assert_allclose(gravity, [0, 9.81, 0], atol=1e-9)


def test_ground_truth_can_be_a_topic_of_poses(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        pose = bag.maker.pose(stamp_ns(k), (0.5 * k, 0.0, 0.0))
        bag.write("/ground_truth/pose", "geometry_msgs/msg/PoseStamped", stamp_ns(k), pose)

    recording = open_recording(make_bag(tmp_path / "a", fill))
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth.T_world_camera[3, :3, 3], [1.5, 0, 0])
    assert "ground truth /ground_truth/pose" in recording.summary


@pytest.mark.parametrize(("root", "is_true"), [("world", True), ("odom", False), ("map", False)])
def test_poses_that_a_robot_estimated_are_no_ground_truth(
    tmp_path: Path, root: str, is_true: bool
) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        t, make = stamp_ns(k), bag.maker
        moved = make.transform(t, root, "base_link", (0.1 * k, 0.0, 0.0))
        bag.transforms("/tf", t, TF, moved, make.transform(t, "base_link", FRAME, (0.0, 0, 1.0)))

    assert (open_recording(make_bag(tmp_path / "a", fill)).ground_truth is not None) == is_true


@pytest.mark.parametrize(("kind", "wrong"), [("bag", 0), ("sqlite3", 3), ("mcap", 8)])
def test_a_frame_an_hour_ahead_is_left_out_and_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str, wrong: int
) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k, k + 108_000 * (k == wrong))

    with RecordingCamera(make_bag(tmp_path / "a.bag", fill, kind, count=9)) as camera:
        numbers = [frame.stamp_s for frame in camera]
    # At the end it may as well be a pause of the recording.
    assert len(numbers) == (9 if wrong == 8 else 8)
    left_out = "2 images are left out, because their stamps are wrong"
    assert caplog.text.count(left_out) == (0 if wrong == 8 else 1)


@pytest.mark.parametrize("seconds", [1, 100])
def test_all_frames_after_a_clock_was_set_back_are_read_in_the_order_of_recording(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, seconds: int
) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k, k if k < 40 else k - 30 * seconds)

    with RecordingCamera(make_bag(tmp_path / "a", fill, count=60)) as camera:
        frames = list(camera)
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.color_bgr, color_image(k))
    assert len(frames) == 60
    jump = f"the clock jumps back by {seconds:.1f} s after 1305031103.475291"
    assert caplog.text.count(jump) == 1


def test_playback_in_real_time_goes_on_after_a_clock_was_set_back(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k, k if k < 20 else k - 3000)

    path = make_bag(tmp_path / "a", fill, count=40)
    offsets_s = playback_offsets_s(open_recording(path).frames.pairs)
    np.testing.assert_allclose(np.diff(offsets_s)[:19], 1 / 30, atol=1e-6)
    assert offsets_s[20] == offsets_s[19]
    np.testing.assert_allclose(np.diff(offsets_s)[20:], 1 / 30, atol=1e-6)


def test_a_repeated_or_late_frame_is_left_out(tmp_path: Path) -> None:
    stamps = [0, 1, 2, 2, 4, 3, 5, 6]
    fill: Fill = lambda bag, k: write_frame(bag, k, stamps[k])  # noqa: E731
    recording = open_recording(make_bag(tmp_path / "a", fill, count=len(stamps)))
    assert len(recording.frames.pairs) == 6
    assert "4 images are left out" in recording.warning


def test_frames_after_a_jump_ahead_of_the_clock_are_read(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a", lambda bag, k: write_frame(bag, k + 100_000 * (k > 1)))
    with RecordingCamera(path) as camera:
        stamps_s = [frame.stamp_s for frame in camera]
    assert len(stamps_s) == 4
    assert stamps_s[2] - stamps_s[1] > 3000.0


def test_stamps_that_fall_most_of_the_time_are_refused(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a", lambda bag, k: write_frame(bag, k, 100 - k), count=9)
    assert "the stamps of most images are before earlier ones; record again" in complaint(path)


def test_color_without_depth_of_its_own_rate_is_counted(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        (write_color if k % 2 else write_frame)(bag, k)

    recording = open_recording(make_bag(tmp_path / "a", fill, count=6))
    assert (len(recording.frames.pairs), recording.frames.unpaired) == (3, 3)
    assert "3 images without a partner" in recording.summary


def test_a_bag_without_images_is_refused(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        bag.write("/chatter", "std_msgs/msg/String", k, bag.maker.make("std_msgs/msg/String", "hi"))

    assert complaint(make_bag(tmp_path / "a", fill)) == (
        "BAG: holds no images that can be read, but /chatter (std_msgs/msg/String); images are "
        "sensor_msgs/Image or CompressedImage, in MCAP as ROS 2 writes them (encoding cdr): "
        "convert them to these"
    )
    path = make_bag(tmp_path / "b", write_color)
    assert complaint(path).startswith(
        "BAG: no topic of depth images; name two of these with --topics"
    )
    assert "no images at topic /nowhere" in complaint(path, topics=("/nowhere", DEPTH_TOPIC))


@pytest.mark.parametrize("kind", KINDS)
def test_topics_of_unknown_types_are_left_alone(tmp_path: Path, kind: str) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        name = "robot_msgs/msg/Odd"
        if k == 0:
            bag.maker.store.register(get_types_from_msg("float64[] numbers", name))
        bag.write("/odd", name, stamp_ns(k), bag.maker.make(name, np.ones(3)))
        write_frame(bag, k)

    path = make_bag(tmp_path / ("a.bag" if kind == "bag" else "a"), fill, kind)
    assert len(open_recording(path).frames.pairs) == 4


def test_a_message_that_is_not_of_its_type_is_one_clear_line(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        write_frame(bag, k)
        connection = bag.connections[DEPTH_TOPIC]
        bag.writer.write(connection, stamp_ns(k) + 1, b"\x00\x01\x00\x00\x07")

    message = complaint(make_bag(tmp_path / "a", fill))
    assert message == f"BAG/a.mcap: a message of {DEPTH_TOPIC} is no sensor_msgs/msg/Image"


def write_two_cameras(bag: BagWriter, k: int) -> None:
    t, make = stamp_ns(k), bag.maker
    for name in ("front", "rear"):
        bag.write(f"/{name}/color/camera_info", INFO, t, make.info(t))
        bag.write(f"/{name}/color/image_raw", IMAGE, t, make.image(t, color_image(k), "bgr8"))
        bag.write(f"/{name}/depth/image_raw", IMAGE, t, make.image(t, depth_mm(k), "16UC1"))


def test_two_cameras_must_be_chosen_from(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a", write_two_cameras)
    assert "are equally good" in complaint(path)
    topics = ("/rear/color/image_raw", "/rear/depth/image_raw")
    assert len(open_recording(path, topics=topics).frames.pairs) == 4


def test_another_size_of_depth_is_refused(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a", partial(write_frame, depth=depth_mm(0)[:, :32]))
    assert "color is 64x48 but depth" in complaint(path)


def test_a_lens_model_that_is_not_browns_is_refused(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        lens = bag.maker.info(0, distortion=(0.1,) * 8, model="rational_polynomial")
        write_frame(bag, k, info={"d": lens.d, "distortion_model": lens.distortion_model})

    assert "the lens model rational_polynomial with 8" in complaint(make_bag(tmp_path / "a", fill))


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"k": np.zeros(9)}, "its K is zero"),
        ({"k": np.array([np.nan, 0, 32, 0, 500, 24, 0, 0, 1])}, "its K or D is not finite"),
        ({"k": np.array([500, 0, np.inf, 0, 500, 24, 0, 0, 1])}, "its K or D is not finite"),
        ({"d": np.array([np.nan, 0, 0, 0, 0])}, "its K or D is not finite"),
        ({"k": np.array([-500.0, 0, 32, 0, 500, 24, 0, 0, 1])}, "its focal length is -500 and 500"),
        ({"width": 0}, "its size is 0x48"),
    ],
)
def test_a_camera_info_without_calibration_is_refused_with_the_reason(
    tmp_path: Path, change: dict[str, Any], fault: str
) -> None:
    path = make_bag(tmp_path / "a", partial(write_frame, info=change))
    assert complaint(path) == (
        f"BAG: {INFO_TOPIC}: the camera is not calibrated ({fault}); give the camera file with "
        "--camera-file"
    )


@pytest.mark.parametrize(
    ("encoding", "is_whole"), [("ros1", True), ("json", True), ("json", False)]
)
def test_an_mcap_of_other_encodings_names_them(
    tmp_path: Path, encoding: str, is_whole: bool
) -> None:
    path = tmp_path / "a.mcap"
    writer = mcap.writer.Writer(str(path))
    writer.start()
    schema = writer.register_schema("sensor_msgs/Image", "ros1msg", b"")
    channels = [writer.register_channel("/rgb/image", encoding, schema)]
    channels += [writer.register_channel(f"/a{n}", encoding, 0) for n in range(5)]
    for channel in channels:
        writer.add_message(channel, log_time=1, publish_time=1, data=b"{}")
    writer.finish()  # type: ignore[no-untyped-call]
    if not is_whole:
        path.write_bytes(path.read_bytes()[:-300])
    assert complaint(path).startswith(
        "BAG: holds no images that can be read, but "
        f"/rgb/image (sensor_msgs/Image in the encoding {encoding}), "
        f"/a0 (no type in the encoding {encoding}), "
    )


def test_a_damaged_ros1_bag_is_one_clear_line(tmp_path: Path) -> None:
    path = make_bag(tmp_path / "a.bag", kind="bag")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert complaint(path) == (
        "BAG: the bag has no usable index, because it was not closed or cut off; "
        "run `rosbag reindex` on it"
    )
    path.write_bytes(b"not a bag")
    assert complaint(path).startswith("BAG: cannot be read: ")
    assert complaint(tmp_path / "gone.mcap") == "BAG: no such file; check the path"


def test_an_mcap_that_was_cut_off_is_read_up_to_its_last_chunk(tmp_path: Path) -> None:
    (file,) = make_bag(tmp_path / "a", count=200).glob("*.mcap")
    data = file.read_bytes()
    whole = len(open_recording(file).frames.pairs)
    file.write_bytes(data[: len(data) // 2])
    with RecordingCamera(file) as camera:
        frames = list(camera)
        assert "cut off and read up to its last whole chunk" in camera.recording.summary
    assert 0 < len(frames) < whole
    np.testing.assert_array_equal(frames[-1].color_bgr, color_image(len(frames) - 1))
    file.write_bytes(data[:20])
    assert complaint(file) == "BAG: holds no messages; is it a complete recording?"


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_bag(tmp_path / "a.bag", kind="bag")
    monkeypatch.setitem(sys.modules, "mcap", None)
    assert "run: pip install 'kinect-vo[bags]'" in complaint(path)
