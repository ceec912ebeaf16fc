"""The messages of ``sensor_msgs`` that an RGB-D camera needs."""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.ros_messages import BytesLike, CdrReader, CdrWriter, reading

IMAGE_SCHEMA = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE_SCHEMA = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO_SCHEMA = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD_SCHEMA = "sensor_msgs/msg/PointCloud2"
IMU_SCHEMA = "sensor_msgs/msg/Imu"

# Array type and number of channels by encoding (sensor_msgs/image_encodings.hpp).
_ENCODINGS = {"bgr8": (np.uint8, 3), "16UC1": (np.uint16, 1)}
# Before the PNG of compressedDepth: coding 0 (inverse depth), and its two parameters, which 16UC1
# does not use.
DEPTH_PNG_HEADER = struct.pack("<iff", 0, 0.0, 0.0)
# sensor_msgs/msg/PointField.FLOAT32
_FLOAT32 = 7
_POINT_FIELDS = {"x": 0, "y": 4, "z": 8, "rgb": 12}
_POINT = np.dtype([("xyz", "<f4", 3), ("bgr", "u1", 3), ("unused", "u1")])


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
    dtype, channels = _ENCODINGS[message.encoding]
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


def decode_image(payload: BytesLike) -> RawImageMessage:
    """Decode an image in one of the encodings of `RawImageMessage`, without a copy of its pixels.

    Raises:
        ValueError: The bytes are not such a message.
    """
    with reading(payload, IMAGE_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        height, width = reader.uint32(), reader.uint32()
        encoding = reader.string()
        is_bigendian, step = reader.uint8(), reader.uint32()
        data = reader.byte_sequence()
        if encoding not in _ENCODINGS or is_bigendian:
            raise ValueError(f"its encoding is {encoding!r}, not one of {', '.join(_ENCODINGS)}")
        dtype, channels = _ENCODINGS[encoding]
        if step != width * channels * np.dtype(dtype).itemsize:
            raise ValueError(f"a row of {width} pixels has {step} bytes")
        pixels = data.view(dtype).reshape((height, width, channels)[: 2 + (channels > 1)])
    return RawImageMessage(stamp_s, frame_id, encoding, pixels)


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


def decode_compressed_image(payload: BytesLike) -> CompressedImageMessage:
    """Decode a message; its image stays compressed.

    Raises:
        ValueError: The bytes are not such a message.
    """
    with reading(payload, COMPRESSED_IMAGE_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        return CompressedImageMessage(stamp_s, frame_id, reader.string(), reader.byte_sequence())


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
    points = np.zeros(len(message.xyz_m), _POINT)
    points["xyz"], points["bgr"] = message.xyz_m, message.bgr
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.uint32(1, len(points))
    writer.uint32(len(_POINT_FIELDS))
    for name, offset in _POINT_FIELDS.items():
        writer.string(name)
        writer.uint32(offset)
        writer.uint8(_FLOAT32)
        writer.uint32(1)
    writer.uint8(0)  # is_bigendian
    writer.uint32(_POINT.itemsize, points.nbytes)
    writer.byte_sequence(points)
    writer.uint8(1)  # is_dense
    return writer.to_bytes()


def decode_point_cloud(payload: BytesLike) -> PointCloudMessage:
    """Decode points with the layout of `encode_point_cloud`, without a copy.

    Raises:
        ValueError: The bytes are not such a message.
    """
    with reading(payload, POINT_CLOUD_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        reader.uint32(), reader.uint32()
        fields = dict(_read_field(reader) for _ in range(reader.uint32()))
        reader.uint8()
        point_step, _ = reader.uint32(), reader.uint32()
        if fields != _POINT_FIELDS or point_step != _POINT.itemsize:
            raise ValueError(f"its fields are {', '.join(fields)}, {point_step} bytes a point")
        points = reader.byte_sequence().view(_POINT)
    return PointCloudMessage(stamp_s, frame_id, points["xyz"], points["bgr"])


def _read_field(reader: CdrReader) -> tuple[str, int]:
    name, offset = reader.string(), reader.uint32()
    reader.uint8(), reader.uint32()
    return name, offset


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


def decode_color_jpeg(message: CompressedImageMessage) -> NDArray[np.uint8]:
    """Decode a compressed color image to (height, width, 3) uint8, BGR.

    Raises:
        ValueError: It cannot be decoded.
    """
    import cv2  # a client without compressed images needs no OpenCV

    image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"an image in the format {message.format!r} cannot be decoded")
    return image.astype(np.uint8, copy=False)


def decode_depth_png(message: CompressedImageMessage) -> NDArray[np.uint16]:
    """Decode compressedDepth of 16UC1 to (height, width) uint16, millimeters.

    Raises:
        ValueError: It cannot be decoded.
    """
    import cv2

    data = np.frombuffer(message.data, np.uint8)[len(DEPTH_PNG_HEADER) :]
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise ValueError(f"depth in the format {message.format!r} cannot be decoded")
    return image.astype(np.uint16, copy=False)
