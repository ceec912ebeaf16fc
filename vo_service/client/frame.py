"""A frame and a point cloud as a client gets them: arrays, intrinsics, and the pose."""

import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.client.pose import Pose, ReceivedPose, parse_pose_sample
from vo_service.ros_messages.sensors import (
    CompressedImageMessage,
    PointCloudMessage,
    RawImageMessage,
)


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
        from vo_service.frame_messages import decode_color_jpeg  # loads OpenCV

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
        from vo_service.frame_messages import decode_depth_png  # loads OpenCV

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
        return self._cloud.bgr[:, ::-1]


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
        pose: The pose.
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

    def __init__(self, session: zenoh.Session, prefix: str, topics: Iterable[str]) -> None:
        self._topics = frozenset(topics)
        self._poses: dict[bytes, ReceivedPose] = {}
        self._payloads: dict[bytes, dict[str, bytes]] = {}
        self._attachment = b""
        self._newest: AssembledFrame | None = None  # that nobody has read
        self._is_closed = False
        self._changed = threading.Condition()
        self._subscribers = [
            session.declare_subscriber(f"{prefix}/{topic}", partial(self._on_sample, topic))
            for topic in (POSE_TOPIC, *self._topics)
        ]

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
