"""Output of frames. Here: the keys of a frame, their message types, and how each is encoded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import zenoh

from drivers.camera import NewReadings
from drivers.core.geometry import Array, quaternion_from_rotation
from vo_service.config_tables import FramesConfig, Ros2Config
from vo_service.frame_messages import FrameMessages
from vo_service.ros_messages.sensors import (
    CAMERA_INFO_SCHEMA,
    COMPRESSED_IMAGE_SCHEMA,
    IMAGE_SCHEMA,
    IMU_SCHEMA,
    POINT_CLOUD_SCHEMA,
    encode_camera_info,
    encode_compressed_image,
    encode_image,
    encode_imu,
    encode_point_cloud,
)
from vo_service.types import OdometryUpdate, OnlineFocalLength, OnlineTiming
from vo_service.types.messages import FrameAttachment, TimingMessage, encode_message


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


def timing_payload(update: OdometryUpdate) -> bytes:
    """Encode the sensor's timing and focal length in use as JSON."""
    timing = update.estimate.timing or OnlineTiming(update.frame.readout_s, 0.0, 0.0, 0.0, "")
    focal_length = update.estimate.focal_length or OnlineFocalLength(1.0, 0.0, None)
    return encode_message(
        TimingMessage(
            stamp_s=update.stamp_s,
            readout_s=timing.readout_s,
            readout_sigma_s=timing.readout_sigma_s,
            depth_offset_s=timing.depth_offset_s,
            depth_offset_sigma_s=timing.depth_offset_sigma_s,
            source=timing.source,
            focal_scale=focal_length.scale,
            focal_scale_sigma=focal_length.sigma,
        )
    )


def frame_attachment(update: OdometryUpdate, T_base_camera: Array) -> bytes:
    """Encode the JSON attachment: the pose's number, and where the camera is in the base."""
    x, y, z = T_base_camera[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_from_rotation(T_base_camera[:3, :3]).tolist()
    return encode_message(FrameAttachment(update.seq, (x, y, z), (qx, qy, qz, qw)))


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
