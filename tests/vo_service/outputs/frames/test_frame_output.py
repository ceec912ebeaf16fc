"""Frames over Zenoh: what is sent, when, and that poses do not notice."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from drivers.core.geometry import T_BODY_CAMERA
from drivers.ros_messages.decoding import (
    decode_odometry,
)
from drivers.ros_messages.sensors import IMU_SCHEMA
from tests.vo_service.outputs.frames.frame_robot import Robot, running_robot
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import connected_session
from tests.waiting import wait_until
from vo_service.config_tables import FramesConfig, ZenohConfig
from vo_service.outputs.frames.output import FrameOutputConfig, open_frame_outputs
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.zenoh

ROS = get_typestore(Stores.ROS2_JAZZY)
TYPES = {
    "color/image": "sensor_msgs/msg/Image",
    "depth/image": "sensor_msgs/msg/Image",
    "color/compressed": "sensor_msgs/msg/CompressedImage",
    "depth/compressed": "sensor_msgs/msg/CompressedImage",
    "color/camera_info": "sensor_msgs/msg/CameraInfo",
    "depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "points": "sensor_msgs/msg/PointCloud2",
    "imu": "sensor_msgs/msg/Imu",
}


@pytest.fixture
def robot(free_port: int) -> Iterator[Robot]:
    with running_robot(free_port) as made:
        yield made


class Subscriber:
    """Keeps the samples of some topics, by topic."""

    def __init__(self, session: zenoh.Session, *names: str) -> None:
        self.samples: dict[str, list[zenoh.Sample]] = {name: [] for name in names}
        for name in names:
            session.declare_subscriber(f"kinect/{name}", self.samples[name].append)

    def wait(self, count: int = 1) -> dict[str, zenoh.Sample]:
        wait_until(lambda: all(len(samples) >= count for samples in self.samples.values()))
        return {name: samples[count - 1] for name, samples in self.samples.items()}


def stamp_of(sample: zenoh.Sample) -> bytes:
    return sample.payload.to_bytes()[4:12]


@contextmanager
def subscribed(robot: Robot, port: int, *names: str) -> Iterator[Subscriber]:
    with connected_session(port) as session:
        subscriber = Subscriber(session, *names)
        wait_until(lambda: all(robot.is_wanted(name) for name in names if name != "odom"))
        yield subscriber


def test_every_message_has_its_type_and_the_stamp_of_the_pose(robot: Robot, free_port: int) -> None:
    with subscribed(robot, free_port, "odom", *TYPES) as subscriber:
        update = robot.publish()
        samples = subscriber.wait()
    stamps = {stamp_of(sample) for sample in samples.values()}
    assert len(stamps) == 1
    for name, schema in TYPES.items():
        message: Any = ROS.deserialize_cdr(samples[name].payload.to_bytes(), schema)
        assert message.header.frame_id == "camera_rgb_optical_frame"
        assert str(samples[name].encoding) == f"application/cdr;{schema}"
    odometry = decode_odometry(samples["odom"].payload.to_bytes())
    assert odometry.stamp_s == pytest.approx(update.stamp_s, abs=1e-9)


def test_timing_is_json(robot: Robot, free_port: int) -> None:
    with subscribed(robot, free_port, "timing") as subscriber:
        update = robot.publish()
        timing = json.loads(subscriber.wait()["timing"].payload.to_bytes())
    assert timing["stamp_s"] == update.stamp_s
    assert timing["readout_sigma_s"] == 0.0  # this odometry learns nothing


def test_only_what_somebody_subscribes_to_is_encoded(
    robot: Robot, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded: list[str] = []

    def encode_nothing(name: str, _: OdometryUpdate) -> list[bytes]:
        encoded.append(name)
        return []

    robot.frames._topics[:] = [
        replace(topic, encode=partial(encode_nothing, topic.name)) for topic in robot.frames._topics
    ]
    robot.frames.declare(robot.poses._endpoints[0].session)
    with subscribed(robot, free_port, "odom", "depth/image"):
        robot.publish()
        wait_until(lambda: bool(encoded))
    wait_until(lambda: not robot.is_wanted("depth/image"))
    robot.publish()
    robot.poses.close()
    robot.frames.close()
    assert encoded == ["depth/image"]


def test_a_subscriber_of_everything_gets_everything(robot: Robot, free_port: int) -> None:
    received: set[str] = set()
    with connected_session(free_port) as session:
        session.declare_subscriber("kinect/**", lambda sample: received.add(str(sample.key_expr)))
        wait_until(lambda: all(robot.is_wanted(name) for name in TYPES))
        robot.publish()
        wait_until(lambda: received >= {f"kinect/{name}" for name in ("odom", *TYPES)})


def test_a_frame_is_queued_once_its_pose_is_sent(free_port: int) -> None:
    sent: list[int] = []
    queued: list[tuple[int, list[int]]] = []
    extras = ExtraEndpoints(on_pose=lambda update: queued.append((update.seq, sent.copy())))
    poses = ZenohOutput(ZenohConfig(listen=(f"tcp/127.0.0.1:{free_port}",)), extra_endpoints=extras)
    (endpoints,) = poses._endpoints

    def publish(name: str, payload: bytes, attachment: bytes) -> None:
        sent.append(json.loads(attachment)["seq"])

    endpoints.publish = publish  # type: ignore[method-assign, assignment]
    for seq in range(3):
        poses.on_update(make_update(seq))
    poses.close()
    assert queued[-1] == (2, [0, 1, 2])
    assert all(seq == done[-1] for seq, done in queued)


def test_the_rate_is_limited(free_port: int) -> None:
    with (
        running_robot(free_port, max_hz=10.0) as robot,
        subscribed(robot, free_port, "odom", "timing") as subscriber,
    ):
        for count in range(1, 10):  # stamps of 30 Hz
            robot.publish()
            wait_until(lambda count=count: len(subscriber.samples["odom"]) == count)  # type: ignore[misc]
        robot.frames.close()
        subscriber.wait(3)
        assert len(subscriber.samples["timing"]) == 3


def test_each_reading_of_the_accelerometer_is_sent_once_with_its_own_stamp(
    robot: Robot, free_port: int
) -> None:
    with subscribed(robot, free_port, "odom", "imu") as subscriber:
        updates = []
        for count in range(1, 8):  # at 30 Hz, with readings at 10 Hz
            updates.append(robot.publish())
            wait_until(lambda count=count: len(subscriber.samples["odom"]) == count)  # type: ignore[misc]
        subscriber.wait(3)
        payloads = [each.payload.to_bytes() for each in subscriber.samples["imu"]]
    messages: list[Any] = [ROS.deserialize_cdr(payload, IMU_SCHEMA) for payload in payloads]
    stamps_s = [updates[seq].stamp_s for seq in (0, 3, 6)]
    sent_s = [each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in messages]
    assert sent_s == pytest.approx(stamps_s, abs=1e-6)
    measured = messages[0].linear_acceleration
    assert (measured.x, measured.y, measured.z) == (0.0, -9.81, 0.0)


def test_a_slow_encoder_delays_no_pose(robot: Robot, free_port: int) -> None:
    release = threading.Event()
    robot.frames._topics[:] = [
        replace(topic, encode=lambda _: [str(release.wait(100)).encode()])
        for topic in robot.frames._topics
    ]
    robot.frames.declare(robot.poses._endpoints[0].session)
    with subscribed(robot, free_port, "odom", "color/image") as subscriber:
        for count in range(1, 21):
            robot.publish()
            wait_until(lambda count=count: len(subscriber.samples["odom"]) == count)  # type: ignore[misc]
        release.set()
    assert robot.frames.dropped > 10


def test_a_frame_that_cannot_be_encoded_is_a_warning_until_the_next(
    robot: Robot, free_port: int
) -> None:
    with subscribed(robot, free_port, "points") as subscriber:
        update = make_update(0)
        robot.frames.queue(replace(update, stamp_s=float("inf")))
        wait_until(lambda: "stamp inf is not a time" in robot.frames.warning)
        robot.publish()
        subscriber.wait()
        wait_until(lambda: robot.frames.warning == "")


@pytest.mark.parametrize(
    ("zenoh_config", "count"),
    [
        (ZenohConfig(), 1),
        (ZenohConfig(listen=("tcp/0.0.0.0:7450",)), 0),
        (ZenohConfig(connect=("tcp/192.168.1.2:7447",)), 0),
        (ZenohConfig(connect=("tls/router.local:7447",)), 1),
    ],
)
def test_images_are_not_published_where_anyone_could_see_them(
    zenoh_config: ZenohConfig, count: int, caplog: pytest.LogCaptureFixture
) -> None:
    settings = FrameOutputConfig("kinect", FramesConfig(), T_BODY_CAMERA)
    opened = open_frame_outputs(settings, zenoh_config)
    for output in opened:
        output.close()
    assert len(opened) == count
    assert ("anyone in the network could see them" in caplog.text) == (count == 0)


def topics_of(frames: FramesConfig, has_scan: bool | None, listen: str) -> list[str]:
    settings = FrameOutputConfig("kinect", frames, T_BODY_CAMERA, has_scan=has_scan)
    opened = open_frame_outputs(settings, ZenohConfig(listen=(listen,)))
    for output in opened:
        output.close()
    return [topic.name for output in opened for topic in output._topics]


@pytest.mark.parametrize("scan", [None, True, False])
@pytest.mark.parametrize("frames", [None, True, False])
def test_images_and_the_scan_are_enabled_apart(frames: bool | None, scan: bool | None) -> None:
    local, network = "tcp/127.0.0.1:7450", "tcp/0.0.0.0:7450"
    for listen, default in ((local, True), (network, False)):
        names = topics_of(FramesConfig(enabled=frames), scan, listen)
        has_images = default if frames is None else frames
        assert ("color/image" in names) == has_images
        assert ("scan" in names) == (has_images if scan is None else scan)
