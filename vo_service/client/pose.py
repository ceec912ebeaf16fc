"""A pose and the map->odom transform as a subscriber reads them."""

import threading
import time
from dataclasses import dataclass
from typing import TypeVar

import zenoh

from drivers.core.geometry import Array, quaternion_from_rotation
from drivers.ros_messages.decoding import decode_odometry, decode_transform
from drivers.ros_messages.navigation import OdometryMessage
from vo_service.types.messages import (
    MapOdomAttachment,
    OdomAttachment,
    decode_message,
    parse_json_message,
)

LOST = "lost"
Attachment = TypeVar("Attachment")


@dataclass(frozen=True)
class ReceivedPose:
    """A pose message on arrival.

    Attributes:
        message: The CDR payload, decoded.
        attachment: The JSON attachment, decoded.
        receive_time_s: Time of arrival, CLOCK_MONOTONIC.
        run: How often the service has been started.
    """

    message: OdometryMessage
    attachment: OdomAttachment
    receive_time_s: float
    run: int


@dataclass(frozen=True)
class Pose:
    """Pose of the robot's base.

    Attributes:
        stamp_s: Stamp of the frame, Unix seconds.
        frame_id: Name of the odom frame.
        child_frame_id: Name of the base frame.
        T_odom_base: 4x4; maps coordinates of the base to odom (x forward, y left, z up), meters.
        pose_covariance: 6x6, accumulated since the epoch began; order x y z rx ry rz, axes of odom.
        twist: (6,) m/s and rad/s, axes of the base.
        twist_covariance: 6x6 of this step, axes of the base.
        seq: Number of the pose, counted by the service.
        state: "tracking", "degraded" or "lost"; when lost, this is the last good pose.
        reason: Why the state is not "tracking"; at the start of an epoch, why the epoch began.
        epoch: Changes whenever a pose is not continuous with the one before.
        is_continuous: Whether the pose continues this reader's previous one. False for the first
            pose, in a new epoch and after a restart of the service.
        missed: Poses between this reader's previous one and this one.
        receive_time_s: Time of arrival, this computer's CLOCK_MONOTONIC.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_odom_base: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array
    seq: int
    state: str
    reason: str
    epoch: int
    is_continuous: bool
    missed: int
    receive_time_s: float

    @property
    def position_m(self) -> Array:
        """(3,) x y z in odom, meters."""
        position: Array = self.T_odom_base[:3, 3]
        return position

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the base in odom."""
        return quaternion_from_rotation(self.T_odom_base[:3, :3])

    @property
    def age_s(self) -> float:
        """Seconds since the pose arrived; needs no synchronized clocks."""
        return time.monotonic() - self.receive_time_s

    @property
    def is_lost(self) -> bool:
        """Whether tracking is lost; the pose is then the last good one."""
        return self.state == LOST


class PoseReader:
    """Converts received messages to poses for one reader, who may skip some."""

    def __init__(self) -> None:
        self._last: ReceivedPose | None = None

    def read(self, received: ReceivedPose) -> Pose:
        """Return the pose, compared with this reader's previous one."""
        last, self._last = self._last, received
        return make_pose(received, _is_continuous(last, received), _missed_count(last, received))


class ThreadLocalReader(threading.local):
    """A separate `PoseReader` for each thread."""

    def __init__(self) -> None:
        self.reader = PoseReader()


def make_pose(received: ReceivedPose, is_continuous: bool, missed: int) -> Pose:
    """Combine message and attachment into a pose.

    Args:
        is_continuous: Whether it continues the reader's previous pose.
    """
    message = received.message
    return Pose(
        stamp_s=message.stamp_s,
        frame_id=message.frame_id,
        child_frame_id=message.child_frame_id,
        T_odom_base=message.T_frame_child,
        pose_covariance=message.pose_covariance,
        twist=message.twist,
        twist_covariance=message.twist_covariance,
        **vars(received.attachment),
        is_continuous=is_continuous,
        missed=missed,
        receive_time_s=received.receive_time_s,
    )


def parse_pose_sample(sample: zenoh.Sample, run: int) -> ReceivedPose:
    """Parse a sample of ``odom`` or ``latest``.

    Args:
        run: How often the service has been started.

    Raises:
        ValueError: The message is malformed or of an unknown version.
    """
    attachment = _parse_attachment(OdomAttachment, sample, "a pose")
    message = decode_odometry(sample.payload.to_bytes())
    return ReceivedPose(message, attachment, time.monotonic(), run)


def _is_continuous(last: ReceivedPose | None, received: ReceivedPose) -> bool:
    if last is None or last.run != received.run or received.attachment.seq < last.attachment.seq:
        return False
    return last.attachment.epoch == received.attachment.epoch


def _missed_count(last: ReceivedPose | None, received: ReceivedPose) -> int:
    """Count skipped poses; each run of the service numbers them from 0."""
    if last is None or last.run != received.run:
        return 0
    return max(0, received.attachment.seq - last.attachment.seq - 1)


@dataclass(frozen=True)
class MapOdom:
    """The map->odom transform, as loop closure has corrected it.

    The transform jumps when the map is corrected, so poses in `odom` stay continuous. A pose in the
    map is ``T_map_odom @ pose.T_odom_base`` if `is_localized` holds and both epochs are equal.

    Attributes:
        stamp_s: Stamp of the newest pose at publication, Unix seconds.
        frame_id: Name of the map frame.
        child_frame_id: Name of the odom frame.
        T_map_odom: 4x4; maps coordinates of odom to the map, meters.
        seq: Number of that pose.
        epoch: Epoch of that pose.
        is_localized: False after a reset, a loss or the load of a map, until relocalization
            succeeds; until then the transform is unknown.
        map_keyframes: Number of keyframes in the map.
        loop_closures: Number of loop closures.
        receive_time_s: Time of arrival, this computer's CLOCK_MONOTONIC.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_map_odom: Array
    seq: int
    epoch: int
    is_localized: bool
    map_keyframes: int
    loop_closures: int
    receive_time_s: float

    @property
    def age_s(self) -> float:
        """Seconds since the message arrived; needs no synchronized clocks."""
        return time.monotonic() - self.receive_time_s


def parse_map_odom(sample: zenoh.Sample) -> MapOdom:
    """Parse a sample of ``map_odom``.

    Raises:
        ValueError: The message is malformed or of an unknown version.
    """
    attachment = _parse_attachment(MapOdomAttachment, sample, "a map_odom message")
    message = decode_transform(sample.payload.to_bytes())
    return MapOdom(
        stamp_s=float(message.stamp_s),
        frame_id=message.frame_id,
        child_frame_id=message.child_frame_id,
        T_map_odom=message.T_frame_child,
        **vars(attachment),
        receive_time_s=time.monotonic(),
    )


def _parse_attachment(kind: type[Attachment], sample: zenoh.Sample, what: str) -> Attachment:
    if sample.attachment is None:
        raise ValueError(f"{what} came without its attachment")
    return decode_message(kind, parse_json_message(sample.attachment.to_bytes()), what)
