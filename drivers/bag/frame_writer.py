"""Frames as ROS messages, under the names that depth_image_proc and rtabmap take."""

from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.bag.bag_contents import format_frame_stamps, to_ns
from drivers.bag.bag_writer import BagWriter
from drivers.bag.image_messages import COMPRESSED_DEPTH_HEADER, COMPRESSED_IMAGE, IMAGE
from drivers.bag.topics import CAMERA_INFO, IMU, STRING
from drivers.calibration import CameraCalibration, format_calibration
from drivers.core.errors import InputError
from drivers.core.geometry import Array, Vector, quaternion_from_rotation
from drivers.recording.frames import FrameStamps
from drivers.recording.images import JPEG_START, BgrImage, DepthImage, decode_depth

NS_PER_S = 1_000_000_000
NAMESPACE = "/camera"
CAMERA_FRAME = "camera_rgb_optical_frame"
WORLD_FRAME = "world"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
# ROS defines 16-bit depth as millimeters. Depth in other units is written in meters.
MILLIMETER_DEPTH_FACTOR = 1000.0
MAX_STAMP_S = 2**31  # of ROS 2


class FrameWriter:
    """Writes frames, gravity and true poses as messages.

    The camera file and the exact stamps of each frame are written too, so that the same frames are
    read back bit for bit.

    Args:
        writer: Writes the messages.
        calibration: The camera of all frames.
        start: Stamp of the first message.
    """

    def __init__(self, writer: BagWriter, calibration: CameraCalibration, start: Decimal) -> None:
        self._writer, self._calibration = writer, calibration
        text = self._make(STRING, format_calibration(calibration))
        writer.write(f"{NAMESPACE}/camera_file", STRING, _checked_ns(start), text)

    def write_frame(
        self, stamps: FrameStamps, color: bytes | BgrImage, depth: bytes | DepthImage
    ) -> None:
        """Write the images of a frame: files (PNG, JPEG) with the bytes they have, or raw.

        Raises:
            OSError: Writing fails.
            InputError: The stamps are outside the range of ROS.
            UnreadableFrameError: A file of depth that must be converted cannot be decoded.
        """
        color_ns, depth_ns = _checked_ns(stamps.color), _checked_ns(stamps.depth)
        self._write_color(color_ns, color)
        self._write_camera_info("rgb", color_ns)
        self._write_depth(depth_ns, depth)
        self._write_camera_info("depth_registered", depth_ns)
        # Written last: a frame counts once all of it is in the file.
        text = self._make(STRING, format_frame_stamps(stamps))
        self._writer.write(f"{NAMESPACE}/frame_stamps", STRING, max(color_ns, depth_ns), text)

    def _write_color(self, stamp_ns: int, color: bytes | BgrImage) -> None:
        topic = f"{NAMESPACE}/rgb/image_raw"
        if isinstance(color, bytes):
            kind = "jpeg" if color.startswith(JPEG_START) else "png"
            message = self._compressed(stamp_ns, color, f"bgr8; {kind} compressed bgr8")
            self._writer.write(f"{topic}/compressed", COMPRESSED_IMAGE, stamp_ns, message)
        else:
            self._writer.write(topic, IMAGE, stamp_ns, self._image(stamp_ns, color, "bgr8"))

    def _write_depth(self, stamp_ns: int, depth: bytes | DepthImage) -> None:
        factor, topic = self._calibration.depth_factor, f"{NAMESPACE}/depth_registered/image"
        if factor != MILLIMETER_DEPTH_FACTOR:
            raw = decode_depth(depth, "depth") if isinstance(depth, bytes) else depth
            meters = raw / np.float32(factor)
            self._writer.write(topic, IMAGE, stamp_ns, self._image(stamp_ns, meters, "32FC1"))
        elif isinstance(depth, bytes):
            data = COMPRESSED_DEPTH_HEADER.pack(0, 0.0, 0.0) + depth
            message = self._compressed(stamp_ns, data, "16UC1; compressedDepth png")
            topic = f"{topic}_raw/compressedDepth"
            self._writer.write(topic, COMPRESSED_IMAGE, stamp_ns, message)
        else:
            image = self._image(stamp_ns, depth, "16UC1")
            self._writer.write(f"{topic}_raw", IMAGE, stamp_ns, image)

    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        """Write a reading of the accelerometer, gravity in camera axes. Raises OSError."""
        stamp_ns = _checked_ns(stamp)
        reaction = self._make("geometry_msgs/msg/Vector3", *(-value for value in gravity_m_s2))
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

    def _write_camera_info(self, name: str, stamp_ns: int) -> None:
        c = self._calibration
        K = np.array([c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0])
        P = np.array([c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
        roi = self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        message = self._make(
            CAMERA_INFO, self._header(stamp_ns), c.height, c.width, "plumb_bob",
            np.array(c.distortion, np.float64), K, np.eye(3).ravel(), P, 0, 0, roi,
        )  # fmt: skip
        self._writer.write(f"{NAMESPACE}/{name}/camera_info", CAMERA_INFO, stamp_ns, message)

    def _image(self, stamp_ns: int, image: NDArray[Any], encoding: str) -> Any:
        height, width = image.shape[:2]
        data = np.ascontiguousarray(image).view(np.uint8).ravel()
        header = self._header(stamp_ns)
        return self._make(IMAGE, header, height, width, encoding, 0, len(data) // height, data)

    def _compressed(self, stamp_ns: int, data: bytes, form: str) -> Any:
        pixels = np.frombuffer(data, np.uint8)
        return self._make(COMPRESSED_IMAGE, self._header(stamp_ns), form, pixels)

    def _header(self, stamp_ns: int, frame: str = CAMERA_FRAME) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS_PER_S))
        sequence = [0] if self._writer.is_ros1 else []
        return self._make("std_msgs/msg/Header", *sequence, stamp, frame)

    def _make(self, message_type: str, *values: Any) -> Any:
        return self._writer.store.types[message_type](*values)


def _checked_ns(stamp: Decimal) -> int:
    if not 0 <= stamp < MAX_STAMP_S:
        raise InputError(f"stamp {stamp}: stamps of ROS are between 1970 and 2038; use a folder")
    return to_ns(stamp)
