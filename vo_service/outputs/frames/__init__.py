"""The output of frames: encodes and publishes, on its own thread, what somebody subscribes to.

All messages of a frame have the same stamp, except those of the accelerometer, and the same frame
of the camera, with optical axes: x right, y down, z forward. Depth is registered to color, so one
set of intrinsics belongs to both.
"""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
import zenoh
import zenoh.shm
from numpy.typing import NDArray

from drivers.camera import AccelerometerReading, NewReadings, RgbdFrame
from drivers.core.flow_control import DropOldestQueue, Throttle, WorkerThread
from drivers.core.geometry import Array
from vo_service.config_tables import FramesConfig, Ros2Config, ZenohConfig
from vo_service.outputs.zenoh import endpoints_without_roles
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
from vo_service.types.messages import frame_attachment, timing_payload
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import OutputBase

if TYPE_CHECKING:  # loaded only if it is enabled
    from vo_service.outputs.frames.ros2 import RosFrames

logger = logging.getLogger(__name__)

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
        encoding: zenoh.Encoding,
        key: str,
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


# Three raw color and depth images: what readers hold, and what is on its way to them. Zenoh locks
# the pool in the memory of each process that maps it, and Linux allows a user 8 MB of that.
POOL_BYTES = 6 << 20
# Smaller messages go with the others through the socket.
MIN_SHARED_BYTES = 16 << 10


class SharedPayloads:
    """Places payloads in a pool of shared memory while there is room in it.

    A reader on this computer then maps the payload instead of receiving it; one elsewhere, or
    without rights to the memory, receives it as usual. The pool is made for the first payload. If
    that fails, as with a small or read-only /dev/shm, payloads stay plain bytes.
    """

    def __init__(self, pool_bytes: int = POOL_BYTES) -> None:
        self._pool_bytes = pool_bytes
        self._pools: list[zenoh.shm.ShmProvider] | None = None

    def share(self, payload: bytes) -> zenoh.ZBytes:
        """Return the payload to publish; it may be published several times."""
        if len(payload) < MIN_SHARED_BYTES:
            return zenoh.ZBytes(payload)
        if self._pools is None:
            self._pools = self._make_pools()
        for pool in self._pools:
            try:
                buffer = pool.alloc(len(payload), zenoh.shm.GarbageCollect())
            except zenoh.ZError:  # readers hold all of it
                break
            buffer[:] = payload
            return zenoh.ZBytes(buffer)
        return zenoh.ZBytes(payload)

    def _make_pools(self) -> list[zenoh.shm.ShmProvider]:
        """Return the pool; nothing if this computer has no room for it."""
        try:
            pool = zenoh.shm.ShmProvider.default_backend(self._pool_bytes)
            pool.alloc(1, zenoh.shm.GarbageCollect())  # makes Zenoh's own segments
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # without memory to lock, Zenoh panics: no Exception
            logger.info("frames: no shared memory: %s", str(error).partition("\n")[0])
            return []
        return [pool]


class FrameTopicPublisher:
    """Encodes one topic once for all its keys, if any of them is wanted."""

    def __init__(self, topic: FrameTopic, keys: Sequence[FrameKeyPublisher]) -> None:
        self._topic = topic
        self._keys = keys

    @property
    def is_wanted(self) -> bool:
        """Whether somebody subscribes."""
        return any(key.is_wanted for key in self._keys)

    def publish(
        self, update: OdometryUpdate, attachment: bytes, shared_payloads: SharedPayloads
    ) -> None:
        """Encode and publish the topic of a frame.

        Args:
            update: The frame and its pose.
            attachment: The attachment of its pose.
            shared_payloads: Puts a message into shared memory, once for all keys.

        Raises:
            ValueError: The frame cannot be encoded.
            zenoh.ZError: Publishing fails.
        """
        keys = [key for key in self._keys if key.is_wanted]
        for payload in self._topic.encode(update) if keys else ():
            shared = shared_payloads.share(payload)
            for key in keys:
                key.put(shared, attachment)


CLOSE_TIMEOUT_S = 2.0
# A pose reaches its readers first: copying images would compete with them for a processor.
POSE_LEAD_S = 0.002


class FrameOutput(OutputBase):
    """Publishes frames on the session of the poses; `docs/reference/messages.md` has the keys.

    `ZenohOutput` calls `declare` and `queue`. Without a subscriber, an update costs a microsecond.
    A slow thread or link loses frames.
    """

    def __init__(self, config: FrameOutputConfig) -> None:
        self._config = config
        self._topics = make_topics(config.frames)
        self._publishers: list[FrameTopicPublisher] = []
        self._ros2: RosFrames | None = None
        self._shared_payloads = SharedPayloads()
        self._throttle = Throttle(1.0 / config.frames.max_hz)
        self.warning = ""
        # One frame is being sent while the next one waits.
        self._worker: WorkerThread[OdometryUpdate] = WorkerThread(
            "frames", DropOldestQueue(1), self._publish, lambda: None
        )

    def declare(self, session: zenoh.Session) -> None:
        """Publish on this session from now on."""
        config = self._config
        self._ros2 = self._open_ros2(session)
        self._publishers = [
            FrameTopicPublisher(topic, self._declare_keys(session, topic)) for topic in self._topics
        ]
        if self._ros2 is not None:
            self._ros2.declare_transform(
                config.base_frame_id, config.frames.frame_id, config.T_base_camera
            )

    def _declare_keys(self, session: zenoh.Session, topic: FrameTopic) -> list[FrameKeyPublisher]:
        """Declare the topic's own key, and its keys for ROS 2."""
        cdr = zenoh.Encoding.APPLICATION_CDR
        encoding = (
            cdr.with_schema(topic.schema) if topic.schema else zenoh.Encoding.APPLICATION_JSON
        )
        key = f"{self._config.prefix}/{topic.name}"
        keys = [FrameKeyPublisher(session, encoding, key, lambda own: own)]
        if self._ros2 is not None:
            declare_key = partial(FrameKeyPublisher, session, cdr)
            keys += self._ros2.declare_topic(topic.ros_name, topic.schema, declare_key)
        return keys

    def _open_ros2(self, session: zenoh.Session) -> "RosFrames | None":
        if not self._config.ros2.enabled:
            return None
        from vo_service.outputs.frames.ros2 import RosFrames

        return RosFrames(session, self._config.prefix, self._config.ros2)

    @property
    def dropped(self) -> int:
        """Number of frames that newer ones replaced before they were encoded."""
        return self._worker.dropped

    def queue(self, update: OdometryUpdate) -> None:
        """Queue the frame if somebody subscribes.

        Called once the pose is sent: copying images holds Python's lock, which would delay it.
        """
        is_wanted = any(publisher.is_wanted for publisher in self._publishers)
        if is_wanted and self._throttle.allow(update.stamp_s):
            self._worker.put(update)

    def close(self) -> None:
        """Send the frame that waits."""
        self._worker.close(CLOSE_TIMEOUT_S)

    def _publish(self, update: OdometryUpdate) -> None:
        time.sleep(POSE_LEAD_S)
        attachment = frame_attachment(update, self._config.T_base_camera)
        try:
            for publisher in self._publishers:
                publisher.publish(update, attachment, self._shared_payloads)
        except (ValueError, zenoh.ZError) as error:
            self.warning = f"frames: a frame could not be published: {error}"
            raise
        self.warning = ""


def open_frame_outputs(config: FrameOutputConfig, zenoh_config: ZenohConfig) -> list[FrameOutput]:
    """Open the output; return nothing if frames are not to be published.

    Raises:
        InputError: The configuration of Zenoh is not valid.
    """
    is_enabled = config.frames.enabled
    if is_enabled is None:
        exposed = endpoints_without_roles(zenoh_config)
        is_enabled = not exposed
        if exposed:
            logger.warning(
                "frames: not published: anyone in the network could see them at %s; set "
                "frames.enabled, or see docs/guide/remote-access.md",
                ", ".join(exposed),
            )
    return [FrameOutput(config)] if is_enabled else []
