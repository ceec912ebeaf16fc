"""Small bags as other programs write them, made with rosbags."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer

from drivers.bag.bag_file import ros1_typestore, ros2_typestore

NS_PER_S = 1_000_000_000
START_NS = 1305031102175304000
SIZE = (64, 48)
FRAME = "camera_rgb_optical_frame"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
TF = "tf2_msgs/msg/TFMessage"


class MessageMaker:
    """Makes messages of one ROS version."""

    def __init__(self, is_ros1: bool) -> None:
        self.store = ros1_typestore() if is_ros1 else ros2_typestore()
        self.is_ros1 = is_ros1

    def make(self, name: str, *values: Any) -> Any:
        return self.store.types[name](*values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS_PER_S))
        return self.make("std_msgs/msg/Header", *([0] if self.is_ros1 else []), stamp, frame)

    def image(self, stamp_ns: int, image: NDArray[Any], encoding: str, frame: str = FRAME) -> Any:
        height, width = image.shape[:2]
        data = np.frombuffer(image.tobytes(), np.uint8)
        header = self.header(stamp_ns, frame)
        step = len(data) // height
        return self.make(IMAGE, header, height, width, encoding, 0, step, data)

    def compressed(self, stamp_ns: int, data: bytes, form: str, frame: str = FRAME) -> Any:
        pixels = np.frombuffer(data, np.uint8)
        return self.make(COMPRESSED, self.header(stamp_ns, frame), form, pixels)

    def info(
        self,
        stamp_ns: int,
        focal_px: float = 60.0,
        distortion: tuple[float, ...] = (0.0,) * 5,
        frame: str = FRAME,
        model: str = "plumb_bob",
        size: tuple[int, int] = SIZE,
    ) -> Any:
        (width, height), f = size, focal_px
        cx, cy = (width - 1) / 2, (height - 1) / 2
        K = np.array([f, 0, cx, 0, f, cy, 0, 0, 1.0])
        P = np.array([f - 1, 0, cx, 0, 0, f - 1, cy, 0, 0, 0, 1.0, 0])
        D, R = np.array(distortion), np.eye(3).ravel()
        roi = self.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        header = self.header(stamp_ns, frame)
        return self.make(INFO, header, height, width, model, D, K, R, P, 0, 0, roi)

    def transform(
        self, stamp_ns: int, parent: str, child: str, position: tuple[float, float, float],
        quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
    ) -> Any:  # fmt: skip
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            self.header(stamp_ns, parent),
            child,
            self.make(
                "geometry_msgs/msg/Transform",
                self.make("geometry_msgs/msg/Vector3", *position),
                self.make("geometry_msgs/msg/Quaternion", *quaternion),
            ),
        )

    def imu(self, stamp_ns: int, acceleration: tuple[float, float, float], frame: str) -> Any:
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        return self.make(
            "sensor_msgs/msg/Imu", self.header(stamp_ns, frame),
            self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0), np.full(9, -1.0),
            zero, np.zeros(9), self.make("geometry_msgs/msg/Vector3", *acceleration), np.zeros(9),
        )  # fmt: skip

    def pose(self, stamp_ns: int, position: tuple[float, float, float]) -> Any:
        pose = self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *position),
            self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
        )
        return self.make("geometry_msgs/msg/PoseStamped", self.header(stamp_ns, "world"), pose)


@dataclass
class BagWriter:
    """Writes messages of any topic."""

    writer: Any
    maker: MessageMaker
    connections: dict[str, Any] = field(default_factory=dict)

    def write(self, topic: str, kind: str, log_ns: int, message: Any) -> None:
        store = self.maker.store
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=store)
        serialize = store.serialize_ros1 if self.maker.is_ros1 else store.serialize_cdr
        self.writer.write(self.connections[topic], log_ns, serialize(message, kind))

    def transforms(self, topic: str, log_ns: int, kind: str, *transforms: Any) -> None:
        self.write(topic, kind, log_ns, self.maker.make(kind, list(transforms)))


@contextmanager
def open_writer(
    path: Path, kind: str = "bag", compression: CompressionMode = CompressionMode.NONE
) -> Iterator[BagWriter]:
    """Open a writer: "bag" (ROS 1, bz2), "sqlite3" or "mcap" (both ROS 2)."""
    if kind == "bag":
        ros1 = Ros1Writer(path)
        ros1.set_compression(Ros1Writer.CompressionFormat.BZ2)
        with ros1:
            yield BagWriter(ros1, MessageMaker(is_ros1=True))
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        ros2 = Ros2Writer(path, version=9, storage_plugin=plugin)
        ros2.set_compression(compression, CompressionFormat.ZSTD)
        with ros2:
            yield BagWriter(ros2, MessageMaker(is_ros1=False))


def color_image(k: int) -> NDArray[np.uint8]:
    """Make the k-th color image, BGR."""
    noise = np.random.default_rng(k).integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 2)  # type: ignore[return-value]


def depth_mm(k: int) -> NDArray[np.uint16]:
    """Make the k-th depth image, with pixels without reading."""
    depth = np.random.default_rng(k).integers(500, 4000, SIZE[::-1], dtype=np.uint16)
    depth[:4] = 0
    return depth


def stamp_ns(k: int) -> int:
    """Return the stamp of the k-th frame at 30 Hz."""
    return START_NS + k * 33_333_000


def stamp_s(k: int) -> float:
    """Return the same stamp in seconds, correctly rounded."""
    return float(f"{stamp_ns(k)}e-9")
