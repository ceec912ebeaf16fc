"""The decoding of ROS 2 messages, for those who receive them.

`drivers.ros_messages` has the messages, their layout and their encoding.
"""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, transform_from_pose
from drivers.ros_messages.cdr import CDR_HEADER, BytesLike
from drivers.ros_messages.navigation import (
    OCCUPANCY_GRID_SCHEMA,
    ODOMETRY_SCHEMA,
    TRANSFORM_SCHEMA,
    TWIST_SCHEMA,
    OccupancyGridMessage,
    OdometryMessage,
    TransformMessage,
)
from drivers.ros_messages.sensors import (
    CAMERA_INFO_SCHEMA,
    COMPRESSED_IMAGE_SCHEMA,
    DEPTH_PNG_HEADER,
    ENCODINGS,
    IMAGE_SCHEMA,
    LASER_SCAN_SCHEMA,
    POINT,
    POINT_CLOUD_SCHEMA,
    POINT_FIELDS,
    CameraInfoMessage,
    CompressedImageMessage,
    LaserScanMessage,
    PointCloudMessage,
    RawImageMessage,
)


class CdrReader:
    """Reads the fields of one message, in order.

    Its methods raise ValueError or `struct.error` if the message is too short or malformed;
    `reading` turns them into one ValueError.
    """

    def __init__(self, payload: BytesLike) -> None:
        """Start to read. Raises ValueError."""
        view = memoryview(cast(bytes, payload))
        if view[:4] != CDR_HEADER:
            raise ValueError("not little-endian CDR: the first four bytes are not 00 01 00 00")
        self._body = view[4:]
        self._offset = 0

    def uint8(self) -> int:
        """Read an 8-bit number."""
        return int(self._unpack("<B", 1)[0])

    def uint32(self) -> int:
        """Read a 32-bit number."""
        return int(self._unpack("<I", 4)[0])

    def float32s(self, count: int) -> NDArray[np.float32]:
        """Read 32-bit floats."""
        self._offset += -self._offset % 4
        return np.frombuffer(self._take(4 * count), "<f4").astype(np.float32)

    def float64s(self, count: int) -> Array:
        """Read 64-bit floats."""
        self._offset += -self._offset % 8
        numbers = np.frombuffer(self._take(8 * count), "<f8")
        return numbers.astype(np.float64)

    def string(self) -> str:
        """Read a string."""
        return self.byte_sequence().tobytes().rstrip(b"\x00").decode()

    def byte_sequence(self) -> NDArray[np.uint8]:
        """Read a sequence of bytes, without a copy: a read-only array."""
        return np.frombuffer(self._take(self.uint32()), np.uint8)

    def header(self) -> tuple[float, str]:
        """Read a ``std_msgs/msg/Header``: stamp in seconds, frame."""
        sec, nanosec = self._unpack("<iI", 4)
        return sec + nanosec * 1e-9, self.string()

    @property
    def is_at_end(self) -> bool:
        """Whether all bytes were read."""
        return self._offset >= len(self._body)

    def _unpack(self, layout: str, alignment: int) -> tuple[Any, ...]:
        self._offset += -self._offset % alignment
        return struct.unpack(layout, self._take(struct.calcsize(layout)))

    def _take(self, count: int) -> memoryview:
        taken = self._body[self._offset : self._offset + count]
        if len(taken) < count:
            raise ValueError(f"it ends after {len(self._body) + 4} bytes")
        self._offset += count
        return taken


@contextmanager
def reading(payload: BytesLike, schema: str) -> Iterator[CdrReader]:
    """Read a message in the block.

    Args:
        schema: Its type, for the error.

    Raises:
        ValueError: The bytes are not such a message, in little-endian CDR.
    """
    reader = CdrReader(payload)
    try:
        yield reader
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"not a {schema} message: {error}") from error


# A quaternion whose length differs by more is not a rotation.
MAX_LENGTH_ERROR = 1e-2
# position 3, quaternion 4, covariance 36, twist 6, covariance 36
_ODOMETRY_NUMBERS = 85
_TWIST_NUMBERS = 6
# translation 3, quaternion 4
_TRANSFORM_NUMBERS = 7


def decode_odometry(payload: BytesLike) -> OdometryMessage:
    """Decode a message from `encode_odometry` or any ROS 2 node.

    Raises:
        ValueError: The bytes are not a little-endian Odometry message, or its quaternion does not
            have length 1.
    """
    with reading(payload, ODOMETRY_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        child_frame_id = reader.string()
        numbers = reader.float64s(_ODOMETRY_NUMBERS)
        length = float(np.linalg.norm(numbers[3:7]))
        if not abs(length - 1.0) <= MAX_LENGTH_ERROR:
            raise ValueError(f"its quaternion has length {length:.3g}, not 1")
    return OdometryMessage(
        stamp_s=stamp_s,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        T_frame_child=transform_from_pose(numbers[:3], numbers[3:7]),
        pose_covariance=numbers[7:43].reshape(6, 6),
        twist=numbers[43:49],
        twist_covariance=numbers[49:85].reshape(6, 6),
    )


def decode_twist(payload: BytesLike) -> Array:
    """Decode a velocity (6,) of `encode_twist` or any ROS 2 node: linear m/s, angular rad/s.

    Raises:
        ValueError: The bytes are not such a message, or have more, as a TwistStamped; or a number
            is not finite.
    """
    with reading(payload, TWIST_SCHEMA) as reader:
        twist = reader.float64s(_TWIST_NUMBERS)
        if not reader.is_at_end:
            raise ValueError("it is longer")
        if not np.all(np.isfinite(twist)):
            raise ValueError("it has a number that is not finite")
    return twist


def decode_transform(payload: BytesLike) -> TransformMessage:
    """Decode a message from `encode_transform` or any ROS 2 node. Raises ValueError."""
    with reading(payload, TRANSFORM_SCHEMA) as reader:
        return _read_transform(reader)


def _read_transform(reader: CdrReader) -> TransformMessage:
    stamp_s, frame_id = reader.header()
    child_frame_id = reader.string()
    numbers = reader.float64s(_TRANSFORM_NUMBERS)
    T_frame_child = transform_from_pose(numbers[:3], numbers[3:])
    return TransformMessage(stamp_s, frame_id, child_frame_id, T_frame_child)


def decode_image(payload: BytesLike) -> RawImageMessage:
    """Decode an image in `bgr8` or `16UC1`, without a copy of its pixels. Raises ValueError."""
    with reading(payload, IMAGE_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        height, width = reader.uint32(), reader.uint32()
        encoding = reader.string()
        is_bigendian, step = reader.uint8(), reader.uint32()
        data = reader.byte_sequence()
        if encoding not in ("bgr8", "16UC1") or is_bigendian:
            raise ValueError(f"its encoding is {encoding!r}, not one of bgr8, 16UC1")
        dtype, channels = ENCODINGS[encoding]
        if step != width * channels * np.dtype(dtype).itemsize:
            raise ValueError(f"a row of {width} pixels has {step} bytes")
        pixels = data.view(dtype).reshape((height, width, channels)[: 2 + (channels > 1)])
    return RawImageMessage(stamp_s, frame_id, encoding, pixels)


def decode_compressed_image(payload: BytesLike) -> CompressedImageMessage:
    """Decode a message; its image stays compressed. Raises ValueError."""
    with reading(payload, COMPRESSED_IMAGE_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        return CompressedImageMessage(stamp_s, frame_id, reader.string(), reader.byte_sequence())


def decode_camera_info(payload: BytesLike) -> CameraInfoMessage:
    """Decode intrinsics.

    Raises:
        ValueError: The bytes are not such a message, or the image is distorted.
    """
    with reading(payload, CAMERA_INFO_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        height, width = reader.uint32(), reader.uint32()
        reader.string()
        if np.any(reader.float64s(reader.uint32())):
            raise ValueError("its image is distorted")
        K = reader.float64s(9).reshape(3, 3)
    return CameraInfoMessage(stamp_s, frame_id, width, height, K)


def decode_point_cloud(payload: BytesLike) -> PointCloudMessage:
    """Decode points with the layout of `encode_point_cloud`, without a copy. Raises ValueError."""
    with reading(payload, POINT_CLOUD_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        reader.uint32(), reader.uint32()
        fields = dict(_read_field(reader) for _ in range(reader.uint32()))
        reader.uint8()
        point_step, _ = reader.uint32(), reader.uint32()
        if fields != POINT_FIELDS or point_step != POINT.itemsize:
            raise ValueError(f"its fields are {', '.join(fields)}, {point_step} bytes a point")
        points = reader.byte_sequence().view(POINT)
    return PointCloudMessage(stamp_s, frame_id, points["xyz"], points["bgr"])


def _read_field(reader: CdrReader) -> tuple[str, int]:
    name, offset = reader.string(), reader.uint32()
    reader.uint8(), reader.uint32()
    return name, offset


def decode_laser_scan(payload: BytesLike) -> LaserScanMessage:
    """Decode a scan of `encode_laser_scan` or any ROS 2 node; its intensities are ignored.

    Raises:
        ValueError: The bytes are not such a message.
    """
    with reading(payload, LASER_SCAN_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        limits = [float(limit) for limit in reader.float32s(7)]
        ranges_m = reader.float32s(reader.uint32())
    angle_min, _, increment, _, scan_time, range_min, range_max = limits
    return LaserScanMessage(
        stamp_s, frame_id, angle_min, increment, scan_time, range_min, range_max, ranges_m
    )


def decode_occupancy_grid(payload: BytesLike) -> OccupancyGridMessage:
    """Decode a map of `encode_occupancy_grid` or any ROS 2 node, without a copy of its cells.

    Raises:
        ValueError: The bytes are not such a message, or the map is turned.
    """
    with reading(payload, OCCUPANCY_GRID_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        reader.uint32(), reader.uint32()
        resolution_m = float(reader.float32s(1)[0])
        width, height = reader.uint32(), reader.uint32()
        x, y, _, *rotation = map(float, reader.float64s(_TRANSFORM_NUMBERS))
        if rotation[:3] != [0.0, 0.0, 0.0]:
            raise ValueError("its origin is turned")
        cells = reader.byte_sequence().view(np.int8).reshape(height, width)
    return OccupancyGridMessage(stamp_s, frame_id, resolution_m, (x, y), cells)


def decode_color_jpeg(message: CompressedImageMessage) -> NDArray[np.uint8]:
    """Decode a compressed color image to (height, width, 3) uint8, BGR. Raises ValueError."""
    import cv2  # a client without compressed images needs no OpenCV

    image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"an image in the format {message.format!r} cannot be decoded")
    return image.astype(np.uint8, copy=False)


def decode_depth_png(message: CompressedImageMessage) -> NDArray[np.uint16]:
    """Decode compressedDepth of 16UC1 to (height, width) uint16, millimeters. Raises ValueError."""
    import cv2

    data = np.frombuffer(message.data, np.uint8)[len(DEPTH_PNG_HEADER) :]
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise ValueError(f"depth in the format {message.format!r} cannot be decoded")
    return image.astype(np.uint16, copy=False)
