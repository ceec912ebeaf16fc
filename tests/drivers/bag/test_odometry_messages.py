"""Messages of a base's odometry beside the frames of a bag."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.bag.odometry_messages import read_odometry_messages
from drivers.core import InputError
from drivers.playback.camera import RecordingCamera
from drivers.ros_messages.decoding import decode_odometry
from tests.drivers.bag.bag_maker import FRAME, BagWriter, MessageMaker, open_writer, stamp_ns

ODOMETRY = "nav_msgs/msg/Odometry"


def odometry(maker: MessageMaker, k: int) -> Any:
    position = maker.make("geometry_msgs/msg/Point", 0.1 * k, 0.0, 0.0)
    quaternion = maker.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    zero = maker.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    pose = maker.make("geometry_msgs/msg/Pose", position, quaternion)
    twist = maker.make("geometry_msgs/msg/Twist", zero, zero)
    return maker.make(
        ODOMETRY,
        maker.header(stamp_ns(k), "wheel_odom"),
        "base_link",
        maker.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        maker.make("geometry_msgs/msg/TwistWithCovariance", twist, np.full(36, 0.01)),
    )


def write_odometry(bag: BagWriter, topic: str, count: int = 3) -> None:
    for k in range(count):
        bag.write(topic, ODOMETRY, stamp_ns(k), odometry(bag.maker, k))


@pytest.mark.parametrize("kind", ["bag", "mcap", "sqlite3"])
def test_messages_of_every_format_are_read_as_cdr(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("drive.bag" if kind == "bag" else "drive")
    with open_writer(path, kind) as bag:
        write_odometry(bag, "/wheel_odom")
        write_odometry(bag, "/odom", 1)
        transform = bag.maker.transform(stamp_ns(0), "a", FRAME, (0.0, 0.0, 0.0))
        bag.transforms("/tf", stamp_ns(0), "tf2_msgs/msg/TFMessage", transform)
    found = [decode_odometry(data) for data in read_odometry_messages(path, ["/wheel_odom"])]
    assert [each.position_m[0] for each in found] == pytest.approx([0.0, 0.1, 0.2])
    assert [each.stamp_s for each in found] == pytest.approx([stamp_ns(k) / 1e9 for k in range(3)])
    assert {each.child_frame_id for each in found} == {"base_link"}
    assert len(list(read_odometry_messages(path, ["/wheel_odom", "/odom"]))) == 4
    assert list(read_odometry_messages(path, ["/tf", "/nothing"])) == []


def test_a_damaged_file_is_an_input_error(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    path.write_bytes(b"no bag")
    with pytest.raises(InputError):
        list(read_odometry_messages(path, ["/wheel_odom"]))


def test_a_folder_without_wheels_has_no_messages(recording: Path) -> None:
    assert list(RecordingCamera(recording).recorded_odometry(["/wheel_odom"])) == []
