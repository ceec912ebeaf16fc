"""Output of frames. Here: the keys of a frame, their message types, and how each is encoded.

All messages of a frame have the same stamp, except those of the accelerometer, and the same frame
of the camera, with optical axes: x right, y down, z forward. Depth is registered to color, so one
set of intrinsics belongs to both.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import zenoh
from numpy.typing import NDArray

from drivers.camera import AccelerometerReading, NewReadings, RgbdFrame
from drivers.core.geometry import Array
from vo_service.config_tables import FramesConfig, Ros2Config
from vo_service.ros_messages import (
    CAMERA_INFO_SCHEMA,
    COMPRESSED_IMAGE_SCHEMA,
    DEPTH_PNG_HEADER,
    IMAGE_SCHEMA,
    IMU_SCHEMA,
    POINT_CLOUD_SCHEMA,
    CameraInfoMessage,
    CompressedImageMessage,
    ImuMessage,
    PointCloudMessage,
    RawImageMessage,
    encode_camera_info,
    encode_compressed_image,
    encode_image,
    encode_imu,
    encode_point_cloud,
)
from vo_service.types import OdometryUpdate
from vo_service.types.messages import timing_payload

# Formats as ROS's image_transport_plugins write them.
JPEG_FORMAT = "bgr8; jpeg compressed bgr8"
DEPTH_PNG_FORMAT = "16UC1; compressedDepth png"
# Level 1 without a filter takes 40 % of the time of OpenCV's defaults, for 4 % more bytes.
_PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
_MAX_DEPTH_MM = np.iinfo(np.uint16).max


@dataclass(frozen=True)
class FrameMessages:
    """Makes the messages of one frame; each call makes a new one.

    Attributes:
        frame: The frame.
        stamp_s: Stamp of the frame, Unix seconds.
        frame_id: Frame of the camera.
    """

    frame: RgbdFrame
    stamp_s: float
    frame_id: str

    def color(self) -> RawImageMessage:
        """The color image, ``bgr8``."""
        return RawImageMessage(self.stamp_s, self.frame_id, "bgr8", self.frame.color_bgr)

    def depth(self) -> RawImageMessage:
        """The depth image, ``16UC1``: millimeters, 0 = no reading."""
        return RawImageMessage(self.stamp_s, self.frame_id, "16UC1", depth_in_mm(self.frame))

    def color_jpeg(self, quality: int) -> CompressedImageMessage:
        """The color image as a JPEG of quality 1 to 100."""
        data = _encode(".jpg", self.frame.color_bgr, (cv2.IMWRITE_JPEG_QUALITY, quality))
        return CompressedImageMessage(self.stamp_s, self.frame_id, JPEG_FORMAT, data)

    def depth_png(self) -> CompressedImageMessage:
        """The depth image as a PNG, in the form of ROS's compressedDepth."""
        data = DEPTH_PNG_HEADER + _encode(".png", depth_in_mm(self.frame), _PNG_OPTIONS)
        return CompressedImageMessage(self.stamp_s, self.frame_id, DEPTH_PNG_FORMAT, data)

    def camera_info(self) -> CameraInfoMessage:
        """The intrinsics of both images."""
        camera = self.frame.camera
        return CameraInfoMessage(self.stamp_s, self.frame_id, camera.width, camera.height, camera.K)

    def points(self, stride: int) -> PointCloudMessage:
        """The colored points of the pixels with depth, in the camera's axes.

        Args:
            stride: Use every n-th pixel of every n-th row.
        """
        camera = self.frame.camera
        depth_m = self.frame.depth_m[::stride, ::stride]
        rows, columns = np.nonzero(depth_m)
        z = depth_m[rows, columns]
        x = (columns * stride - camera.cx).astype(np.float32) * z / np.float32(camera.fx)
        y = (rows * stride - camera.cy).astype(np.float32) * z / np.float32(camera.fy)
        bgr = self.frame.color_bgr[::stride, ::stride][rows, columns]
        return PointCloudMessage(self.stamp_s, self.frame_id, np.column_stack([x, y, z]), bgr)

    def imu(self, reading: AccelerometerReading) -> ImuMessage:
        """A reading of the accelerometer, with its own stamp."""
        stamp_s = self.stamp_s + (reading.stamp_s - self.frame.stamp_s)
        return ImuMessage(stamp_s, self.frame_id, np.array(reading.acceleration_m_s2))


def depth_in_mm(frame: RgbdFrame) -> NDArray[np.uint16]:
    """Return the frame's depth in millimeters, 0 = no reading (and from 65.536 m on)."""
    if frame.depth_factor == 1000.0:
        return frame.depth_raw
    depth_mm = np.rint(frame.depth_raw * (1000.0 / frame.depth_factor))
    return np.where(depth_mm <= _MAX_DEPTH_MM, depth_mm, 0).astype(np.uint16)


def _encode(
    suffix: str, image: NDArray[np.uint8] | NDArray[np.uint16], options: tuple[int, ...]
) -> bytes:
    is_encoded, data = cv2.imencode(suffix, image, options)
    if not is_encoded:
        raise ValueError(f"OpenCV cannot write {image.shape} {image.dtype} as {suffix}")
    return data.tobytes()


@dataclass(frozen=True)
class FrameOutputConfig:
    """Configuration of the output.

    Attributes:
        prefix: Prefix of the keys.
        frames: Rate, coding and frame of the camera.
        T_base_camera: 4x4 pose of the optical camera in the base.
        base_frame_id: Frame of the base, for ROS 2.
        ros2: Topics for ROS 2.
    """

    prefix: str
    frames: FramesConfig
    T_base_camera: Array
    base_frame_id: str = "base_link"
    ros2: Ros2Config = Ros2Config()  # noqa: RUF009 (frozen)


# Makes the payloads of an update, usually one.
Encoder = Callable[[OdometryUpdate], Sequence[bytes]]


@dataclass(frozen=True)
class FrameTopic:
    """One topic.

    Attributes:
        name: Key below the prefix.
        ros_name: Topic below the ROS namespace; "" if it is not published for ROS.
        schema: Type of the message; "" for JSON.
        encode: Makes the payloads.
    """

    name: str
    ros_name: str
    schema: str
    encode: Encoder


def make_topics(settings: FramesConfig) -> list[FrameTopic]:
    """Make the topics, in the order in which a frame is sent: small messages first."""

    def messages(update: OdometryUpdate) -> FrameMessages:
        return FrameMessages(update.frame, update.stamp_s, settings.frame_id)

    def camera_info(update: OdometryUpdate) -> list[bytes]:
        return [encode_camera_info(messages(update).camera_info())]

    def color(update: OdometryUpdate) -> list[bytes]:
        return [encode_image(messages(update).color())]

    def depth(update: OdometryUpdate) -> list[bytes]:
        return [encode_image(messages(update).depth())]

    def color_jpeg(update: OdometryUpdate) -> list[bytes]:
        return [encode_compressed_image(messages(update).color_jpeg(settings.jpeg_quality))]

    def depth_png(update: OdometryUpdate) -> list[bytes]:
        return [encode_compressed_image(messages(update).depth_png())]

    def points(update: OdometryUpdate) -> list[bytes]:
        return [encode_point_cloud(messages(update).points(settings.point_stride))]

    rgb, depth_registered = "rgb/image_raw", "depth_registered/image_raw"
    return [
        FrameTopic("timing", "", "", lambda update: [timing_payload(update)]),
        FrameTopic("imu", "imu", IMU_SCHEMA, ImuEncoder(settings.frame_id)),
        FrameTopic("color/camera_info", "rgb/camera_info", CAMERA_INFO_SCHEMA, camera_info),
        FrameTopic(
            "depth/camera_info", "depth_registered/camera_info", CAMERA_INFO_SCHEMA, camera_info
        ),
        FrameTopic("color/image", rgb, IMAGE_SCHEMA, color),
        FrameTopic("depth/image", depth_registered, IMAGE_SCHEMA, depth),
        FrameTopic("color/compressed", f"{rgb}/compressed", COMPRESSED_IMAGE_SCHEMA, color_jpeg),
        FrameTopic(
            "depth/compressed",
            f"{depth_registered}/compressedDepth",
            COMPRESSED_IMAGE_SCHEMA,
            depth_png,
        ),
        FrameTopic("points", "depth_registered/points", POINT_CLOUD_SCHEMA, points),
    ]


class ImuEncoder:
    """Encodes each reading of the accelerometer once."""

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id
        self._new_readings = NewReadings()

    def __call__(self, update: OdometryUpdate) -> list[bytes]:
        """Encode the readings since the last call, in their order."""
        messages = FrameMessages(update.frame, update.stamp_s, self._frame_id)
        readings = self._new_readings.take(update.frame.accelerometer)
        return [encode_imu(messages.imu(reading)) for reading in readings]


# Makes the attachment of a sample from the frame's own one.
AttachmentMaker = Callable[[bytes], bytes]


class FrameKeyPublisher:
    """Publisher of one key that knows whether somebody subscribes.

    Frames give way to everything else on a link, and a reader that is too slow loses them.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        encoding: zenoh.Encoding,
        make_attachment: AttachmentMaker,
    ) -> None:
        self.is_wanted = False
        self._make_attachment = make_attachment
        self._publisher = session.declare_publisher(
            key,
            encoding=encoding,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND,
        )
        self._listener = self._publisher.declare_matching_listener(self._on_match)

    def put(self, payload: zenoh.ZBytes, attachment: bytes) -> None:
        """Publish one sample."""
        self._publisher.put(payload, attachment=self._make_attachment(attachment))

    def _on_match(self, status: zenoh.MatchingStatus) -> None:
        self.is_wanted = status.matching
