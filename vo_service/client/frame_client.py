"""Images, points and their poses from a service, as a subscriber of frames sees them."""

import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from drivers.core.geometry import Array, transform_from_pose
from drivers.ros_messages.decoding import (
    decode_camera_info,
    decode_color_jpeg,
    decode_compressed_image,
    decode_depth_png,
    decode_image,
    decode_laser_scan,
    decode_point_cloud,
)
from drivers.ros_messages.sensors import (
    CompressedImageMessage,
    LaserScanMessage,
    PointCloudMessage,
    RawImageMessage,
)
from vo_service.client.connection import FrameUnavailable, check_timeout
from vo_service.client.pose import Pose, PoseReader, ReceivedPose, parse_pose_sample
from vo_service.client.subscription import ServiceClient
from vo_service.config_tables import DEFAULT_ENDPOINT
from vo_service.outputs.zenoh.zenoh_config import MAX_FRAME_MESSAGE_BYTES
from vo_service.types.messages import FrameAttachment, decode_message, parse_json_message


@dataclass(frozen=True)
class Located:
    """What the camera saw, and where it was.

    Attributes:
        pose: Pose of the base at the stamp, with its covariance; see `Pose.state`.
        T_base_camera: 4x4 pose of the optical camera (x right, y down, z forward) in the base.
    """

    pose: Pose
    T_base_camera: Array

    @property
    def seq(self) -> int:
        """Number of the pose."""
        return self.pose.seq

    @property
    def stamp_s(self) -> float:
        """Stamp of pose and image, Unix seconds."""
        return self.pose.stamp_s

    @property
    def T_odom_camera(self) -> Array:
        """4x4 pose of the optical camera; maps its coordinates to odom, meters."""
        T: Array = self.pose.T_odom_base @ self.T_base_camera
        return T


@dataclass(frozen=True)
class Frame(Located):
    """A color image, the depth image registered to it, and where they were taken.

    Compressed images are decoded when they are first used.

    Attributes:
        K: 3x3 intrinsics of both images, pixels; the center of the first pixel is (0, 0).
    """

    K: Array
    _color: RawImageMessage | CompressedImageMessage
    _depth: RawImageMessage | CompressedImageMessage | None

    @cached_property
    def color_bgr(self) -> NDArray[np.uint8]:
        """(height, width, 3) uint8, OpenCV's channel order. May be read-only.

        Raises:
            ValueError: It cannot be decoded.
        """
        if isinstance(self._color, RawImageMessage):
            return self._color.pixels.astype(np.uint8, copy=False)
        return decode_color_jpeg(self._color)

    @property
    def color_jpeg(self) -> bytes:
        """The JPEG file of a compressed color image.

        Raises:
            ValueError: The image was not asked for as compressed.
        """
        if isinstance(self._color, RawImageMessage):
            raise ValueError("this image is not compressed; ask for frames(compressed=True)")
        return bytes(self._color.data)

    @cached_property
    def depth_mm(self) -> NDArray[np.uint16]:
        """(height, width) uint16, millimeters, 0 = no reading. May be read-only.

        Raises:
            ValueError: It cannot be decoded, or was not asked for.
        """
        if self._depth is None:
            raise ValueError("this frame has no depth; ask for frames(depth=True)")
        if isinstance(self._depth, RawImageMessage):
            return self._depth.pixels.astype(np.uint16, copy=False)
        return decode_depth_png(self._depth)

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32, meters, 0 = no reading. Raises as `depth_mm`."""
        return self.depth_mm * np.float32(1e-3)


@dataclass(frozen=True)
class PointCloud(Located):
    """Colored points, and where they were taken."""

    _cloud: PointCloudMessage

    @property
    def xyz_m(self) -> NDArray[np.float32]:
        """(N, 3) points in the axes of the optical camera, meters."""
        return self._cloud.xyz_m

    @property
    def xyz_odom_m(self) -> Array:
        """(N, 3) points in odom, meters."""
        T = self.T_odom_camera
        points: Array = self._cloud.xyz_m @ T[:3, :3].T + T[:3, 3]
        return points

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """(N, 3) colors, red first."""
        assert self._cloud.bgr is not None, "decode_point_cloud accepts no other"
        return self._cloud.bgr[:, ::-1]


@dataclass(frozen=True)
class Scan(Located):
    """Distances to the nearest obstacles in a horizontal plane, and where they were measured.

    The scan's frame is on the floor below the camera, level, with the camera's yaw.
    """

    _scan: LaserScanMessage

    @property
    def angles_rad(self) -> Array:
        """(N,) directions, counterclockwise from the camera's forward; right is first."""
        return self._scan.angles_rad

    @property
    def ranges_m(self) -> NDArray[np.float32]:
        """(N,) distances from the camera; NaN = unknown, +inf = free as far as it measures."""
        return self._scan.ranges_m


# Frames that wait for the rest of their messages, and poses that wait for their frames.
MAX_INCOMPLETE_FRAMES = 8
MAX_WAITING_POSES = 256
POSE_TOPIC = "odom"
# Seconds and nanoseconds of the header, in CDR.
_STAMP = slice(4, 12)


@dataclass(frozen=True)
class AssembledFrame:
    """All messages of one stamp.

    Attributes:
        payloads: By topic: the CDR message.
        attachment: JSON of one of the frame's messages.
    """

    pose: ReceivedPose
    payloads: Mapping[str, bytes]
    attachment: bytes


class FrameAssembly:
    """Subscribes to topics of the frames and to the poses; keeps the newest complete frame.

    Zenoh's threads store a message and return at once, so nothing piles up behind a slow reader.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._topics = frozenset(topics)
        self._poses: dict[bytes, ReceivedPose] = {}
        self._payloads: dict[bytes, dict[str, bytes]] = {}
        self._attachment = b""
        self._newest: AssembledFrame | None = None  # that nobody has read
        self._is_closed = False
        self._changed = threading.Condition()
        self._subscribers: list[zenoh.Subscriber[None]] = []

    def subscribe(self, session: zenoh.Session, prefix: str) -> None:
        """Subscribe to the topics. Raises ZError if the session is closed."""
        for topic in (POSE_TOPIC, *self._topics):
            self._subscribers.append(
                session.declare_subscriber(f"{prefix}/{topic}", partial(self._on_sample, topic))
            )

    def wait_for_newest(self, timeout_s: float | None) -> AssembledFrame | None:
        """Wait for a frame that was not read yet; None on timeout or `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._is_closed, timeout_s)
            newest, self._newest = self._newest, None
            return None if self._is_closed else newest

    def stop(self) -> None:
        """Wake the reader, on another thread, and give it no more frames."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def close(self) -> None:
        """Unsubscribe."""
        self.stop()
        for subscriber in self._subscribers:
            with suppress(zenoh.ZError):  # the session has closed
                subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _on_sample(self, topic: str, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        stamp = payload[_STAMP]
        with self._changed:
            if topic == POSE_TOPIC:
                with suppress(ValueError):  # `ServiceState` reports it
                    self._poses[stamp] = parse_pose_sample(sample, run=0)
                _drop_oldest(self._poses, MAX_WAITING_POSES)
            else:
                self._payloads.setdefault(stamp, {})[topic] = payload
                _drop_oldest(self._payloads, MAX_INCOMPLETE_FRAMES)
                if sample.attachment is not None:
                    self._attachment = sample.attachment.to_bytes()
            self._complete(stamp)

    def _complete(self, stamp: bytes) -> None:
        payloads, pose = self._payloads.get(stamp, {}), self._poses.get(stamp)
        if pose is not None and payloads.keys() == self._topics:
            for older in list(self._payloads):
                del self._payloads[older]
                if older == stamp:
                    break
            self._newest = AssembledFrame(pose, payloads, self._attachment)
            self._changed.notify_all()


def _drop_oldest(items: dict[bytes, Any], capacity: int) -> None:
    while len(items) > capacity:
        del items[next(iter(items))]


class FrameClient(ServiceClient):
    """Client of one service's frames, on a session of its own: it never delays a `PoseClient`.

    A topic is sent only while a loop over `frames`, `points` or `scans` runs. A slow reader skips
    to the newest frame.
    """

    max_message_bytes = MAX_FRAME_MESSAGE_BYTES

    def __init__(
        self,
        prefix: str = "kinect",
        connect: str = DEFAULT_ENDPOINT,
        config_file: Path | str | None = None,
    ) -> None:
        """Connect to a service; see `ServiceClient`."""
        super().__init__(prefix, connect, config_file)
        self._assemblies: list[FrameAssembly] = []  # of the loops that run

    def close(self) -> None:
        """Disconnect; `frames`, `points` and `scans` end. Safe to call twice."""
        super().close()
        for assembly in list(self._assemblies):
            assembly.stop()

    def frames(
        self, timeout_s: float | None = None, *, depth: bool = True, compressed: bool = False
    ) -> Iterator[Frame]:
        """Iterate over frames as they arrive, newest first.

        Args:
            timeout_s: Longest wait for the next frame; None waits without limit.
            depth: Whether to ask for depth as well.
            compressed: Whether to ask for JPEG, and PNG for depth: for a narrow link.

        Raises:
            FrameUnavailable: No frame arrived in time.
            InputError: The time is not valid.
            ValueError: A message cannot be read.
        """
        form, decode = (
            ("compressed", decode_compressed_image) if compressed else ("image", decode_image)
        )
        color_topic, depth_topic, info_topic = f"color/{form}", f"depth/{form}", "color/camera_info"
        topics = (info_topic, color_topic, *([depth_topic] if depth else []))
        for located, payloads in self._assembled(topics, timeout_s):
            yield Frame(
                located.pose,
                located.T_base_camera,
                decode_camera_info(payloads[info_topic]).K,
                decode(payloads[color_topic]),
                decode(payloads[depth_topic]) if depth else None,
            )

    def points(self, timeout_s: float | None = None) -> Iterator[PointCloud]:
        """Iterate over colored point clouds as they arrive, newest first.

        Args:
            timeout_s: Longest wait for the next cloud; None waits without limit.

        Raises:
            FrameUnavailable: No cloud arrived in time.
            InputError: The time is not valid.
            ValueError: A message cannot be read.
        """
        for located, payloads in self._assembled(("points",), timeout_s):
            yield PointCloud(
                located.pose, located.T_base_camera, decode_point_cloud(payloads["points"])
            )

    def scans(self, timeout_s: float | None = None) -> Iterator[Scan]:
        """Iterate over scans as they arrive, newest first.

        Args:
            timeout_s: Longest wait for the next scan; None waits without limit.

        Raises:
            FrameUnavailable: No scan arrived in time.
            InputError: The time is not valid.
            ValueError: A message cannot be read.
        """
        for located, payloads in self._assembled(("scan",), timeout_s):
            yield Scan(located.pose, located.T_base_camera, decode_laser_scan(payloads["scan"]))

    def _assembled(
        self, topics: tuple[str, ...], timeout_s: float | None
    ) -> Iterator[tuple[Located, Mapping[str, bytes]]]:
        check_timeout(timeout_s)
        reader = PoseReader()
        assembly = FrameAssembly(topics)
        self._assemblies.append(assembly)  # first, so that `close` finds it at any time
        try:
            self._subscribe(assembly, timeout_s)
            while not self._state.is_closed and (frame := assembly.wait_for_newest(timeout_s)):
                yield _locate(frame, reader), frame.payloads
        finally:
            self._assemblies.remove(assembly)
            assembly.close()
        if not self._state.is_closed:
            raise FrameUnavailable(self._no_frame_reason(topics, timeout_s))

    def _subscribe(self, assembly: FrameAssembly, timeout_s: float | None) -> None:
        """Subscribe when there is a session: it may open later. Nothing after `close`."""
        if not self._connection.sessions:
            self._state.wait_until_alive(timeout_s)
        try:
            for session in self._connection.sessions:
                assembly.subscribe(session, self._prefix)
                return
        except zenoh.ZError:
            if not self._state.is_closed:
                raise
        if not self._state.is_closed:
            raise FrameUnavailable(f"{self._prefix}: no service or router is reachable")

    def _no_frame_reason(self, topics: tuple[str, ...], timeout_s: float | None) -> str:
        where = f"{self._prefix}: no frame within {timeout_s or 0.0:g} s: "
        status = self._state.status.item
        if not self._state.is_alive:
            return where + "no kinect-vo publishes there, or access is denied"
        if status is not None and status["state"] in ("no_camera", "lost"):
            return where + f"{status['state']}: {status['reason']}"
        return where + (
            f"the service is up but sends no {' or '.join(topics)}: frames.enabled is false, this "
            "client may not see images, or the link is too narrow (try compressed=True)"
        )


def _locate(frame: AssembledFrame, reader: PoseReader) -> Located:
    content = parse_json_message(frame.attachment)
    attachment = decode_message(FrameAttachment, content, "a frame")
    T_base_camera = transform_from_pose(
        attachment.camera_position_m, attachment.camera_quaternion_xyzw
    )
    return Located(reader.read(frame.pose), T_base_camera)
