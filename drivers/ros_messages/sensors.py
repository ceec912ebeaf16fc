"""Images, intrinsics, points and accelerometer readings as ROS 2 messages."""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.ros_messages.cdr import BytesLike, CdrWriter, StampSeconds

IMAGE_SCHEMA = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE_SCHEMA = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO_SCHEMA = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD_SCHEMA = "sensor_msgs/msg/PointCloud2"
IMU_SCHEMA = "sensor_msgs/msg/Imu"
# Array type and number of channels by encoding (sensor_msgs/image_encodings.hpp).
ENCODINGS = {"bgr8": (np.uint8, 3), "16UC1": (np.uint16, 1), "32FC1": (np.float32, 1)}
# compressed_depth_image_transport puts this before the image: a format, and two coefficients of
# inverse depth, which only depth in meters uses.
COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")
DEPTH_PNG_HEADER = COMPRESSED_DEPTH_HEADER.pack(0, 0.0, 0.0)
# Formats of compressed images, as ROS's image_transport_plugins write them.
JPEG_FORMAT = "bgr8; jpeg compressed bgr8"
PNG_FORMAT = "bgr8; png compressed bgr8"
DEPTH_PNG_FORMAT = "16UC1; compressedDepth png"
# sensor_msgs/msg/PointField.FLOAT32
_FLOAT32 = 7
POINT_FIELDS = {"x": 0, "y": 4, "z": 8, "rgb": 12}
UNCOLORED_POINT = np.dtype([("xyz", "<f4", 3)])
POINT = np.dtype([("xyz", "<f4", 3), ("bgr", "u1", 3), ("unused", "u1")])


@dataclass(frozen=True)
class RawImageMessage:
    """A raw image.

    Attributes:
        stamp_s: Time of the image, Unix seconds.
        frame_id: Frame of the camera, with optical axes: x right, y down, z forward.
        encoding: ``bgr8``, or of depth ``16UC1`` in millimeters, ``32FC1`` in meters; 0 = no
            reading.
        pixels: (height, width, 3) uint8 for ``bgr8``, else (height, width) uint16 or float32.
    """

    stamp_s: StampSeconds
    frame_id: str
    encoding: str
    pixels: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]


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
    """

    stamp_s: StampSeconds
    frame_id: str
    format: str
    data: BytesLike


def encode_compressed_image(message: CompressedImageMessage) -> bytes:
    """Encode a compressed image as CDR. Raises ValueError."""
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.format)
    writer.byte_sequence(message.data)
    return writer.to_bytes()


@dataclass(frozen=True)
class CameraInfoMessage:
    """Intrinsics of an image.

    Attributes:
        stamp_s: Time of the image, Unix seconds.
        frame_id: Frame of the camera, with optical axes.
        K: 3x3 intrinsics, pixels; the center of the first pixel is (0, 0).
        distortion: k1 k2 p1 p2 k3.
    """

    stamp_s: StampSeconds
    frame_id: str
    width: int
    height: int
    K: Array
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)


def encode_camera_info(message: CameraInfoMessage) -> bytes:
    """Encode the intrinsics as CDR, with model ``plumb_bob``.

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
    writer.float64s(np.array(message.distortion))
    writer.float64s(message.K.ravel())
    writer.float64s(np.eye(3).ravel())  # rectification
    writer.float64s(np.hstack([message.K, np.zeros((3, 1))]).ravel())  # projection
    writer.uint32(0, 0)  # binning
    writer.uint32(0, 0, 0, 0)  # region of interest: the whole image
    writer.uint8(0)
    return writer.to_bytes()


@dataclass(frozen=True)
class PointCloudMessage:
    """Points.

    Attributes:
        stamp_s: Time of the points, Unix seconds.
        xyz_m: (N, 3) float32.
        bgr: (N, 3) uint8; None for points without color.
    """

    stamp_s: StampSeconds
    frame_id: str
    xyz_m: NDArray[np.float32]
    bgr: NDArray[np.uint8] | None


def encode_point_cloud(message: PointCloudMessage) -> bytes:
    """Encode points as CDR: one row, fields x, y, z and, with color, rgb of 4 bytes each.

    Raises:
        ValueError: The stamp does not fit, or a point is not finite.
    """
    if not np.all(np.isfinite(message.xyz_m)):
        raise ValueError(f"points at {message.stamp_s} s have a number that is not finite")
    points = np.zeros(len(message.xyz_m), POINT if message.bgr is not None else UNCOLORED_POINT)
    points["xyz"] = message.xyz_m
    if message.bgr is not None:
        points["bgr"] = message.bgr
    fields = {name: at for name, at in POINT_FIELDS.items() if at < points.itemsize}
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.uint32(1, len(points))
    writer.uint32(len(fields))
    for name, offset in fields.items():
        writer.string(name)
        writer.uint32(offset)
        writer.uint8(_FLOAT32)
        writer.uint32(1)
    writer.uint8(0)  # is_bigendian
    writer.uint32(points.itemsize, points.nbytes)
    writer.byte_sequence(points)
    writer.uint8(1)  # is_dense
    return writer.to_bytes()


@dataclass(frozen=True)
class ImuMessage:
    """A measurement of an accelerometer.

    Attributes:
        stamp_s: Time of the measurement, Unix seconds.
        acceleration_m_s2: (3,) specific force: at rest it points up (REP 145).
    """

    stamp_s: StampSeconds
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


LASER_SCAN_SCHEMA = "sensor_msgs/msg/LaserScan"


@dataclass(frozen=True)
class LaserScanMessage:
    """Distances in a horizontal plane, all measured at the stamp.

    Attributes:
        stamp_s: Time of the scan, Unix seconds.
        frame_id: Frame of the scan: x forward, y left, z up.
        angle_min_rad: Angle of the first range; angles grow counterclockwise.
        angle_increment_rad: Angle between two ranges.
        scan_time_s: Time between two scans.
        range_min_m: Least valid range.
        range_max_m: Largest valid range.
        ranges_m: (N,) float32; NaN = unknown, +inf = free up to `range_max_m` (REP 117).
    """

    stamp_s: float
    frame_id: str
    angle_min_rad: float
    angle_increment_rad: float
    scan_time_s: float
    range_min_m: float
    range_max_m: float
    ranges_m: NDArray[np.float32]

    @property
    def angle_max_rad(self) -> float:
        """Angle of the last range."""
        return self.angle_min_rad + (len(self.ranges_m) - 1) * self.angle_increment_rad

    @property
    def angles_rad(self) -> Array:
        """(N,) angles of the ranges."""
        steps = np.arange(len(self.ranges_m), dtype=np.float64)
        return self.angle_min_rad + self.angle_increment_rad * steps


def encode_laser_scan(message: LaserScanMessage) -> bytes:
    """Encode a scan as CDR, without intensities.

    Raises:
        ValueError: The stamp does not fit.
    """
    limits = [
        message.angle_min_rad,
        message.angle_max_rad,
        message.angle_increment_rad,
        0.0,  # time_increment: all ranges are of one image
        message.scan_time_s,
        message.range_min_m,
        message.range_max_m,
    ]
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.float32s(np.array(limits))
    writer.uint32(len(message.ranges_m))
    writer.float32s(message.ranges_m)
    writer.uint32(0)  # intensities
    return writer.to_bytes()
