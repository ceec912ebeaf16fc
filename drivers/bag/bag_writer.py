"""Writing of frames as ROS messages: MCAP, ROS 2 bag, ROS 1 bag."""

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1LibraryWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter
from rosbags.typesys.store import Typestore

from drivers.bag.bag_contents import (
    CAMERA_INFO,
    COMPRESSED_PARTS,
    IMU,
    OWN_IMAGES,
    STRING,
    VECTOR_STAMPED,
    format_frame_stamps,
    to_ns,
)
from drivers.bag.bag_file import ros1_typestore, ros2_typestore
from drivers.bag.image_messages import COMPRESSED_DEPTH_HEADER, COMPRESSED_IMAGE, IMAGE
from drivers.calibration import CameraCalibration, format_calibration
from drivers.core import InputError
from drivers.core.geometry import Array, Vector, quaternion_from_rotation
from drivers.recording import JPEG_START, BgrImage, DepthImage, decode_depth
from drivers.recording.frames import FrameStamps

ROS2_BAG_VERSION: Literal[9] = 9


@dataclass(frozen=True)
class EncodedMessage:
    """A message as it is stored: CDR for MCAP and ROS 2.

    Attributes:
        topic: Its topic.
        message_type: Such as "nav_msgs/msg/Odometry".
        log_ns: Its log time.
        data: The encoded message.
    """

    topic: str
    message_type: str
    log_ns: int
    data: bytes


class BagWriter(ABC):
    """Writes messages of any topic; a topic is made with its first message.

    Attributes:
        store: Types of the messages.
        is_ros1: Whether headers have a sequence number, as in ROS 1.
    """

    is_ros1 = False

    def __init__(self, store: Typestore) -> None:
        self.store = store
        self._channels: dict[str, Any] = {}

    def write(self, topic: str, message_type: str, log_ns: int, message: Any) -> None:
        """Write a message.

        Raises:
            OSError: Writing fails.
        """
        data = self.encode(topic, message_type, message)
        self.write_encoded(EncodedMessage(topic, message_type, log_ns, data))

    def encode(self, topic: str, message_type: str, message: Any) -> bytes:
        """Encode the next message of a topic.

        Args:
            topic: The topic.
            message_type: Its type, such as "nav_msgs/msg/Odometry".
            message: The message.
        """
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        return bytes(serialize(message, message_type))

    def write_encoded(self, message: EncodedMessage) -> None:
        """Write a message that is encoded already.

        Raises:
            OSError: Writing fails.
        """
        if message.topic not in self._channels:
            self.add_topic(message.topic, message.message_type, self.store)
        self._write(self._channels[message.topic], message.log_ns, message.data)

    def add_topic(self, topic: str, message_type: str, store: Typestore) -> None:
        """Add a topic whose type is not defined by this object's `store`.

        Args:
            topic: The topic.
            message_type: Its type, such as "nav_msgs/msg/Odometry".
            store: Defines the type.
        """
        self._channels[topic] = self._add_channel(topic, message_type, store)

    @abstractmethod
    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any: ...

    @abstractmethod
    def _write(self, channel: Any, log_ns: int, data: bytes) -> None: ...

    @abstractmethod
    def close(self) -> None:
        """Complete the file. Raises OSError."""


class McapWriter(BagWriter):
    """Writes MCAP to an open file, in chunks compressed with LZ4."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(ros2_typestore())
        self._file = file
        self._writer = McapLibraryWriter(file, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library="kinect-vo")

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> int:
        definition, _ = store.generate_msgdef(message_type, ros_version=2)
        schema = self._writer.register_schema(message_type, "ros2msg", definition.encode())
        return self._writer.register_channel(topic, "cdr", schema)

    def _write(self, channel: int, log_ns: int, data: bytes) -> None:
        self._writer.add_message(channel, log_ns, data, publish_time=log_ns)

    def flush(self) -> None:
        """Hand everything written so far to the system, so that a crash does not lose it.

        Raises:
            OSError: Writing fails.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()


class RosbagsWriter(BagWriter):
    """Writes a bag with the writers of rosbags."""

    _writer: Ros1LibraryWriter | Ros2LibraryWriter

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any:
        return self._writer.add_connection(topic, message_type, typestore=store)

    def _write(self, channel: Any, log_ns: int, data: bytes) -> None:
        self._writer.write(channel, log_ns, data)

    def close(self) -> None:
        self._writer.close()

    def abort(self) -> None:
        """Close the file without completing it."""
        self._writer.abort()


class Ros1Writer(RosbagsWriter):
    """Writes a ROS 1 bag, not compressed: ROS reads only LZ4 frames that rosbags does not write.

    The images are PNG or JPEG, from which compression of the chunks would save one percent.
    """

    is_ros1 = True
    _writer: Ros1LibraryWriter

    def __init__(self, path: Path) -> None:
        super().__init__(ros1_typestore())
        self._counts: Counter[str] = Counter()
        self._writer = Ros1LibraryWriter(path)
        try:
            self._writer.open()
        except OSError:
            self.abort()
            raise

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any:
        latching = 1 if topic == "/tf_static" else None
        return self._writer.add_connection(topic, message_type, typestore=store, latching=latching)

    def encode(self, topic: str, message_type: str, message: Any) -> bytes:
        """Encode a message; its header gets the number of the topic's messages before it.

        Args:
            topic: The topic.
            message_type: Its type, such as "nav_msgs/msg/Odometry".
            message: The message.
        """
        if hasattr(message, "header"):
            message.header.seq = self._counts[topic]
            self._counts[topic] += 1
        return super().encode(topic, message_type, message)


class Ros2Writer(RosbagsWriter):
    """Writes a ROS 2 bag with SQLite into a new folder.

    Args:
        path: The folder.

    Raises:
        InputError: The path has characters that SQLite replaces.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(ros2_typestore())
        if not {"%", "?", "#"}.isdisjoint(str(path)):  # rosbags opens it as a URI
            raise InputError(f"{path}: a ROS 2 bag cannot have %, ? or # in its path; rename it")
        self._writer = Ros2LibraryWriter(
            path, version=ROS2_BAG_VERSION, storage_plugin=StoragePlugin.SQLITE3
        )
        self._writer.open()


NS_PER_S = 1_000_000_000
NAMESPACE = "/camera"
CAMERA_FRAME = "camera_rgb_optical_frame"
WORLD_FRAME = "world"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
# ROS defines 16-bit depth as millimeters. Depth in other units is written in meters.
MILLIMETER_DEPTH_FACTOR = 1000.0
MAX_STAMP_S = 2**31  # of ROS 2
# The topics that frames are written to.
FRAME_TOPICS = frozenset(
    NAMESPACE + name
    for name in (
        "/camera_file",
        "/frame_stamps",
        "/rgb/camera_info",
        "/depth_registered/camera_info",
        *OWN_IMAGES,
        *(f"{image}/{part}" for image in OWN_IMAGES for part in COMPRESSED_PARTS),
    )
)


class FrameWriter:
    """Writes frames, readings of the accelerometer, gravity and true poses as messages.

    The camera file and the exact stamps of each frame are written too, so that the same frames are
    read back bit for bit.

    Args:
        writer: Writes the messages.
        calibration: The camera of all frames.
        start: Stamp of the first message.
        camera_frame: The name of the color camera's frame.
    """

    def __init__(
        self,
        writer: BagWriter,
        calibration: CameraCalibration,
        start: Decimal,
        camera_frame: str = CAMERA_FRAME,
    ) -> None:
        self._writer, self._calibration = writer, calibration
        self._camera_frame = camera_frame
        text = self._make(STRING, format_calibration(calibration))
        writer.write(f"{NAMESPACE}/camera_file", STRING, _checked_ns(start), text)

    def write_frame(
        self,
        stamps: FrameStamps,
        color: bytes | BgrImage,
        depth: bytes | DepthImage,
        logged: FrameStamps | None = None,
    ) -> None:
        """Write the images of a frame: files (PNG, JPEG) with the bytes they have, or raw.

        Args:
            stamps: Exact stamps of both images, s.
            color: A file, or the (H, W, 3) image.
            depth: A file, or the (H, W) image in units of the camera file.
            logged: Log times of both images, s; None for the stamps.

        Raises:
            OSError: Writing fails.
            InputError: The stamps are outside the range of ROS.
            UnreadableFrameError: A file of depth that must be converted cannot be decoded.
        """
        color_ns, depth_ns = _checked_ns(stamps.color), _checked_ns(stamps.depth)
        logged = logged or stamps
        color_log_ns, depth_log_ns = to_ns(logged.color), to_ns(logged.depth)
        self._write_color(color_ns, color, color_log_ns)
        self._write_camera_info("rgb", color_ns, color_log_ns)
        self._write_depth(depth_ns, depth, depth_log_ns)
        self._write_camera_info("depth_registered", depth_ns, depth_log_ns)
        # Written last: a frame counts once all of it is in the file.
        text = self._make(STRING, format_frame_stamps(stamps))
        log_ns = max(color_log_ns, depth_log_ns)
        self._writer.write(f"{NAMESPACE}/frame_stamps", STRING, log_ns, text)

    def _write_color(self, stamp_ns: int, color: bytes | BgrImage, log_ns: int) -> None:
        topic = f"{NAMESPACE}/rgb/image_raw"
        if isinstance(color, bytes):
            kind = "jpeg" if color.startswith(JPEG_START) else "png"
            message = self._compressed(stamp_ns, color, f"bgr8; {kind} compressed bgr8")
            self._writer.write(f"{topic}/compressed", COMPRESSED_IMAGE, log_ns, message)
        else:
            self._writer.write(topic, IMAGE, log_ns, self._image(stamp_ns, color, "bgr8"))

    def _write_depth(self, stamp_ns: int, depth: bytes | DepthImage, log_ns: int) -> None:
        factor, topic = self._calibration.depth_factor, f"{NAMESPACE}/depth_registered/image"
        if factor != MILLIMETER_DEPTH_FACTOR:
            raw = decode_depth(depth, "depth") if isinstance(depth, bytes) else depth
            meters = raw / np.float32(factor)
            self._writer.write(topic, IMAGE, log_ns, self._image(stamp_ns, meters, "32FC1"))
        elif isinstance(depth, bytes):
            data = COMPRESSED_DEPTH_HEADER.pack(0, 0.0, 0.0) + depth
            message = self._compressed(stamp_ns, data, "16UC1; compressedDepth png")
            topic = f"{topic}_raw/compressedDepth"
            self._writer.write(topic, COMPRESSED_IMAGE, log_ns, message)
        else:
            image = self._image(stamp_ns, depth, "16UC1")
            self._writer.write(f"{topic}_raw", IMAGE, log_ns, image)

    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        """Write a frame's gravity in camera axes. Raises OSError."""
        stamp_ns = _checked_ns(stamp)
        vector = self._make("geometry_msgs/msg/Vector3", *gravity_m_s2)
        message = self._make(VECTOR_STAMPED, self._header(stamp_ns), vector)
        self._writer.write(f"{NAMESPACE}/gravity", VECTOR_STAMPED, stamp_ns, message)

    def write_reading(self, stamp: Decimal, acceleration_m_s2: Vector) -> None:
        """Write a reading of the accelerometer in camera axes. Raises OSError."""
        stamp_ns = _checked_ns(stamp)
        reaction = self._make("geometry_msgs/msg/Vector3", *acceleration_m_s2)
        unknown = np.array([-1.0, *[0.0] * 8])
        no_turn = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        no_rate = self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        message = self._make(
            IMU, self._header(stamp_ns), no_turn, unknown, no_rate, unknown, reaction, np.zeros(9)
        )  # fmt: skip
        self._writer.write(f"{NAMESPACE}/imu", IMU, stamp_ns, message)

    def write_true_pose(self, stamp: Decimal, T_world_camera: Array) -> None:
        """Write a true pose of the camera. Raises OSError."""
        stamp_ns = _checked_ns(stamp)
        x, y, z = T_world_camera[:3, 3].tolist()
        quaternion = quaternion_from_rotation(T_world_camera[:3, :3]).tolist()
        pose = self._make(
            "geometry_msgs/msg/Pose",
            self._make("geometry_msgs/msg/Point", x, y, z),
            self._make("geometry_msgs/msg/Quaternion", *quaternion),
        )
        message = self._make(POSE_STAMPED, self._header(stamp_ns, WORLD_FRAME), pose)
        self._writer.write("/ground_truth", POSE_STAMPED, stamp_ns, message)

    def _write_camera_info(self, name: str, stamp_ns: int, log_ns: int) -> None:
        c = self._calibration
        K = np.array([c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0])
        P = np.array([c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
        roi = self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        message = self._make(
            CAMERA_INFO, self._header(stamp_ns), c.height, c.width, "plumb_bob",
            np.array(c.distortion, np.float64), K, np.eye(3).ravel(), P, 0, 0, roi,
        )  # fmt: skip
        self._writer.write(f"{NAMESPACE}/{name}/camera_info", CAMERA_INFO, log_ns, message)

    def _image(self, stamp_ns: int, image: NDArray[Any], encoding: str) -> Any:
        height, width = image.shape[:2]
        data = np.ascontiguousarray(image).view(np.uint8).ravel()
        header = self._header(stamp_ns)
        return self._make(IMAGE, header, height, width, encoding, 0, len(data) // height, data)

    def _compressed(self, stamp_ns: int, data: bytes, form: str) -> Any:
        pixels = np.frombuffer(data, np.uint8)
        return self._make(COMPRESSED_IMAGE, self._header(stamp_ns), form, pixels)

    def _header(self, stamp_ns: int, frame: str | None = None) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS_PER_S))
        sequence = [0] if self._writer.is_ros1 else []
        frame = self._camera_frame if frame is None else frame
        return self._make("std_msgs/msg/Header", *sequence, stamp, frame)

    def _make(self, message_type: str, *values: Any) -> Any:
        return self._writer.store.types[message_type](*values)


def _checked_ns(stamp: Decimal) -> int:
    if not 0 <= stamp < MAX_STAMP_S:
        raise InputError(f"stamp {stamp}: stamps of ROS are between 1970 and 2038; use a folder")
    return to_ns(stamp)
