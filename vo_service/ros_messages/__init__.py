"""ROS 2 messages in plain CDR, and their encoding. Needs only numpy.

Poses and transforms come first, then the messages of a camera. Layout: 4 bytes of header
(``00 01 00 00``, little endian), then the fields in order. Each field is aligned to its own size,
counted from the end of the header (OMG DDS-XTypes, "plain CDR"). `decoding` reads them.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, quaternion_from_rotation

CDR_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
# Anything that gives its bytes without a copy; an array must be contiguous.
BytesLike = bytes | bytearray | memoryview | NDArray[Any]


class CdrWriter:
    """Writes the fields of one message, in order."""

    def __init__(self) -> None:
        self._parts: list[bytes | memoryview] = [CDR_HEADER]
        self._length = 0  # without the header

    def uint8(self, value: int) -> None:
        """Write an 8-bit number."""
        self._append(struct.pack("<B", value))

    def uint32(self, *values: int) -> None:
        """Write 32-bit numbers."""
        self._align(4)
        self._append(struct.pack(f"<{len(values)}I", *values))

    def float64s(self, numbers: Array) -> None:
        """Write 64-bit floats."""
        self._align(8)
        self._append(numbers.astype("<f8").tobytes())

    def string(self, text: str) -> None:
        """Write a string."""
        self.byte_sequence(text.encode() + b"\x00")

    def byte_sequence(self, data: BytesLike) -> None:
        """Write a sequence of bytes. An array is not copied before `to_bytes`."""
        # The types of Python 3.11 do not have that an array is a buffer.
        view = memoryview(cast(bytes, data)).cast("B")
        self.uint32(len(view))
        self._append(view)

    def header(self, stamp_s: float, frame_id: str) -> None:
        """Write a ``std_msgs/msg/Header``.

        Raises:
            ValueError: The stamp does not fit.
        """
        self._align(4)
        self._append(_STAMP.pack(*split_stamp(stamp_s)))
        self.string(frame_id)

    def to_bytes(self) -> bytes:
        """Return the message."""
        return b"".join(self._parts)

    def _align(self, size: int) -> None:
        self._append(bytes(-self._length % size))

    def _append(self, data: bytes | memoryview) -> None:
        self._parts.append(data)
        self._length += len(data)


STRING_SCHEMA = "std_msgs/msg/String"


def encode_string(text: str) -> bytes:
    """Encode a ``std_msgs/msg/String`` as CDR."""
    writer = CdrWriter()
    writer.string(text)
    return writer.to_bytes()


def split_stamp(stamp_s: float) -> tuple[int, int]:
    """Split a stamp into whole seconds, rounded down, and nanoseconds (0 to 999 999 999).

    Raises:
        ValueError: The seconds do not fit ROS 2's 32 signed bits (they end in 2038).
    """
    if not math.isfinite(stamp_s):
        raise ValueError(f"stamp {stamp_s} is not a time")
    sec = math.floor(stamp_s)
    # The subtraction is exact, so this is the nearest nanosecond; it may round up to a second.
    carry, nanosec = divmod(round((stamp_s - sec) * 1e9), 1_000_000_000)
    sec += carry
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"stamp {stamp_s} s does not fit ROS 2's 32 bits for seconds")
    return sec, nanosec


ODOMETRY_SCHEMA = "nav_msgs/msg/Odometry"
TRANSFORM_SCHEMA = "geometry_msgs/msg/TransformStamped"
TRANSFORMS_SCHEMA = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True)
class OdometryMessage:
    """One odometry message.

    Attributes:
        stamp_s: Stamp of the pose, Unix seconds.
        frame_id: Parent frame of the pose.
        child_frame_id: Frame that moves; the twist is in its axes.
        T_frame_child: 4x4 pose, meters.
        pose_covariance: 6x6, order x y z rx ry rz, axes of `frame_id`.
        twist: (6,) m/s and rad/s.
        twist_covariance: 6x6.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_frame_child: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array

    @property
    def position_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        position: Array = self.T_frame_child[:3, 3]
        return position

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_odometry(message: OdometryMessage) -> bytes:
    """Encode a message as CDR.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
    """
    numbers = np.concatenate(
        [
            message.position_m,
            message.quaternion_xyzw,
            message.pose_covariance.ravel(),
            message.twist,
            message.twist_covariance.ravel(),
        ]
    )
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"odometry at {message.stamp_s} s has a number that is not finite")
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.child_frame_id)
    writer.float64s(numbers)
    return writer.to_bytes()


@dataclass(frozen=True)
class TransformMessage:
    """Transform between two frames.

    Attributes:
        stamp_s: Stamp of the transform, Unix seconds.
        frame_id: Parent frame.
        child_frame_id: Child frame.
        T_frame_child: 4x4, meters.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_frame_child: Array

    @property
    def translation_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        translation: Array = self.T_frame_child[:3, 3]
        return translation

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_transform(message: TransformMessage) -> bytes:
    """Encode a ``TransformStamped`` as CDR.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
    """
    writer = CdrWriter()
    _write_transform(writer, message)
    return writer.to_bytes()


def encode_transforms(messages: Sequence[TransformMessage]) -> bytes:
    """Encode transforms as one ``TFMessage``. Raises as `encode_transform`."""
    writer = CdrWriter()
    writer.uint32(len(messages))
    for message in messages:
        _write_transform(writer, message)
    return writer.to_bytes()


def _write_transform(writer: CdrWriter, message: TransformMessage) -> None:
    if not np.all(np.isfinite(message.T_frame_child)):
        raise ValueError(f"transform at {message.stamp_s} s has a number that is not finite")
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.child_frame_id)
    writer.float64s(np.concatenate([message.translation_m, message.quaternion_xyzw]))


IMAGE_SCHEMA = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE_SCHEMA = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO_SCHEMA = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD_SCHEMA = "sensor_msgs/msg/PointCloud2"
IMU_SCHEMA = "sensor_msgs/msg/Imu"
# Array type and number of channels by encoding (sensor_msgs/image_encodings.hpp).
ENCODINGS = {"bgr8": (np.uint8, 3), "16UC1": (np.uint16, 1)}
# Before the PNG of compressedDepth: coding 0 (inverse depth), and its two parameters, which 16UC1
# does not use.
DEPTH_PNG_HEADER = struct.pack("<iff", 0, 0.0, 0.0)
# sensor_msgs/msg/PointField.FLOAT32
_FLOAT32 = 7
POINT_FIELDS = {"x": 0, "y": 4, "z": 8, "rgb": 12}
POINT = np.dtype([("xyz", "<f4", 3), ("bgr", "u1", 3), ("unused", "u1")])


@dataclass(frozen=True)
class RawImageMessage:
    """A raw image.

    Attributes:
        stamp_s: Time of the image, Unix seconds.
        frame_id: Frame of the camera, with optical axes: x right, y down, z forward.
        encoding: ``bgr8`` or ``16UC1`` (depth in millimeters, 0 = no reading).
        pixels: (height, width, 3) uint8 for ``bgr8``, (height, width) uint16 for ``16UC1``.
    """

    stamp_s: float
    frame_id: str
    encoding: str
    pixels: NDArray[np.uint8] | NDArray[np.uint16]


def encode_image(message: RawImageMessage) -> bytes:
    """Encode an image as CDR.

    Raises:
        ValueError: The stamp does not fit, or the pixels do not have the encoding's type and shape.
    """
    dtype, channels = ENCODINGS[message.encoding]
    pixels = np.ascontiguousarray(message.pixels)
    height, width, *rest = pixels.shape
    if pixels.dtype != dtype or rest != [channels][: channels > 1]:
        raise ValueError(f"{pixels.dtype} {pixels.shape} is not an image in {message.encoding}")
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.uint32(height, width)
    writer.string(message.encoding)
    writer.uint8(0)  # is_bigendian
    writer.uint32(width * channels * pixels.itemsize)
    writer.byte_sequence(pixels)
    return writer.to_bytes()


@dataclass(frozen=True)
class CompressedImageMessage:
    """An image in a file format.

    Attributes:
        stamp_s: Time of the image, Unix seconds.
        frame_id: Frame of the camera, with optical axes.
        format: Encoding of the image and of the data, as ROS's image_transport writes it.
        data: The compressed image.
    """

    stamp_s: float
    frame_id: str
    format: str
    data: BytesLike


def encode_compressed_image(message: CompressedImageMessage) -> bytes:
    """Encode a compressed image as CDR.

    Raises:
        ValueError: The stamp does not fit.
    """
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.format)
    writer.byte_sequence(message.data)
    return writer.to_bytes()


@dataclass(frozen=True)
class CameraInfoMessage:
    """Intrinsics of an undistorted image.

    Attributes:
        stamp_s: Time of the image, Unix seconds.
        frame_id: Frame of the camera, with optical axes.
        width: Columns of the image.
        height: Rows of the image.
        K: 3x3 intrinsics, pixels; the center of the first pixel is (0, 0).
    """

    stamp_s: float
    frame_id: str
    width: int
    height: int
    K: Array


def encode_camera_info(message: CameraInfoMessage) -> bytes:
    """Encode the intrinsics as CDR, with model ``plumb_bob`` and no distortion.

    Raises:
        ValueError: The stamp does not fit, or the intrinsics are not finite.
    """
    if not np.all(np.isfinite(message.K)):
        raise ValueError(f"intrinsics at {message.stamp_s} s have a number that is not finite")
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.uint32(message.height, message.width)
    writer.string("plumb_bob")
    writer.uint32(5)
    writer.float64s(np.zeros(5))  # distortion
    writer.float64s(message.K.ravel())
    writer.float64s(np.eye(3).ravel())  # rectification
    writer.float64s(np.hstack([message.K, np.zeros((3, 1))]).ravel())  # projection
    writer.uint32(0, 0)  # binning
    writer.uint32(0, 0, 0, 0)  # region of interest: the whole image
    writer.uint8(0)
    return writer.to_bytes()


@dataclass(frozen=True)
class PointCloudMessage:
    """Colored points.

    Attributes:
        stamp_s: Time of the points, Unix seconds.
        frame_id: Frame of the points.
        xyz_m: (N, 3) float32.
        bgr: (N, 3) uint8.
    """

    stamp_s: float
    frame_id: str
    xyz_m: NDArray[np.float32]
    bgr: NDArray[np.uint8]


def encode_point_cloud(message: PointCloudMessage) -> bytes:
    """Encode points as CDR: one row, fields x, y, z and rgb of 4 bytes each.

    Raises:
        ValueError: The stamp does not fit, or a point is not finite.
    """
    if not np.all(np.isfinite(message.xyz_m)):
        raise ValueError(f"points at {message.stamp_s} s have a number that is not finite")
    points = np.zeros(len(message.xyz_m), POINT)
    points["xyz"], points["bgr"] = message.xyz_m, message.bgr
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.uint32(1, len(points))
    writer.uint32(len(POINT_FIELDS))
    for name, offset in POINT_FIELDS.items():
        writer.string(name)
        writer.uint32(offset)
        writer.uint8(_FLOAT32)
        writer.uint32(1)
    writer.uint8(0)  # is_bigendian
    writer.uint32(POINT.itemsize, points.nbytes)
    writer.byte_sequence(points)
    writer.uint8(1)  # is_dense
    return writer.to_bytes()


@dataclass(frozen=True)
class ImuMessage:
    """A measurement of an accelerometer.

    Attributes:
        stamp_s: Time of the measurement, Unix seconds.
        frame_id: Frame of the axes.
        acceleration_m_s2: (3,) specific force: at rest it points up (REP 145).
    """

    stamp_s: float
    frame_id: str
    acceleration_m_s2: Array


def encode_imu(message: ImuMessage) -> bytes:
    """Encode a measurement as CDR, without orientation and angular velocity.

    The first covariance of an absent quantity is -1; that of the acceleration is unknown, all 0.

    Raises:
        ValueError: The stamp does not fit, or the acceleration is not finite.
    """
    if not np.all(np.isfinite(message.acceleration_m_s2)):
        raise ValueError(f"acceleration at {message.stamp_s} s is not finite")
    absent = np.array([-1.0, *[0.0] * 8])
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.float64s(np.concatenate([np.array([0.0, 0.0, 0.0, 1.0]), absent]))
    writer.float64s(np.concatenate([np.zeros(3), absent]))
    writer.float64s(np.concatenate([message.acceleration_m_s2, np.zeros(9)]))
    return writer.to_bytes()
