"""The topics of frames, and the encoding of their payloads."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.camera import NewReadings
from drivers.ros_messages.sensors import (
    CAMERA_INFO_SCHEMA,
    COMPRESSED_IMAGE_SCHEMA,
    IMAGE_SCHEMA,
    IMU_SCHEMA,
    LASER_SCAN_SCHEMA,
    POINT_CLOUD_SCHEMA,
    encode_camera_info,
    encode_compressed_image,
    encode_image,
    encode_imu,
    encode_laser_scan,
    encode_point_cloud,
)
from vo_service.config_tables import FramesConfig
from vo_service.outputs.frames.frame_messages import FrameMessages
from vo_service.types.messages import timing_payload
from vo_service.types.odometry_update import OdometryUpdate

# Makes the payloads of an update, usually one.
Encoder = Callable[[OdometryUpdate], Sequence[bytes]]


@dataclass(frozen=True)
class FrameTopic:
    """One topic.

    Attributes:
        name: Key below the prefix.
        schema: Type of the message; "" for JSON.
        encode: Makes the payloads.
    """

    name: str
    schema: str
    encode: Encoder


def make_topics(settings: FramesConfig, frame_id: str) -> list[FrameTopic]:
    """Make the topics, in the order in which a frame is sent: small messages first.

    Args:
        settings: Coding of the images, and stride of the points.
        frame_id: Frame of images and points.
    """

    def messages(update: OdometryUpdate) -> FrameMessages:
        return FrameMessages(update.frame, update.stamp_s, frame_id)

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

    return [
        FrameTopic("timing", "", lambda update: [timing_payload(update)]),
        FrameTopic("imu", IMU_SCHEMA, ImuEncoder(frame_id)),
        FrameTopic("color/camera_info", CAMERA_INFO_SCHEMA, camera_info),
        FrameTopic("depth/camera_info", CAMERA_INFO_SCHEMA, camera_info),
        FrameTopic("color/image", IMAGE_SCHEMA, color),
        FrameTopic("depth/image", IMAGE_SCHEMA, depth),
        FrameTopic("color/compressed", COMPRESSED_IMAGE_SCHEMA, color_jpeg),
        FrameTopic("depth/compressed", COMPRESSED_IMAGE_SCHEMA, depth_png),
        FrameTopic("points", POINT_CLOUD_SCHEMA, points),
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


def encode_scan(update: OdometryUpdate) -> list[bytes]:
    """Encode the scan, if there is one."""
    message = update.scan.message()
    return [] if message is None else [encode_laser_scan(message)]


SCAN_TOPIC = FrameTopic("scan", LASER_SCAN_SCHEMA, encode_scan)
