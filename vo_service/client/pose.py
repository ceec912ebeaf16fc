"""A pose as a reader gets it, and reading one from what came over Zenoh."""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import zenoh

from drivers.core.geometry import Array, quaternion_from_rotation
from vo_service.client.message_parsing import check_fields, parse_json
from vo_service.outputs.zenoh.cdr_odometry import OdometryMessage, decode_odometry

LOST = "lost"
_ATTACHMENT_FIELDS = {"seq": int, "state": str, "epoch": int, "reason": str}


@dataclass(frozen=True)
class ReceivedPose:
    """A pose when it came: the message, its attachment, CLOCK_MONOTONIC, and of which run."""

    message: OdometryMessage
    attachment: Mapping[str, Any]
    receive_time_s: float
    run: int


@dataclass(frozen=True)
class Pose:
    """Where the robot's base is.

    stamp_s           instant of the frame, Unix seconds
    T_odom_base       4x4; maps coordinates of the base to odom (x forward, y left, z up), metres
    pose_covariance   6x6, accumulated since the epoch began; order x y z rx ry rz, axes of odom
    twist             (6,) m/s and rad/s, axes of the base
    twist_covariance  6x6 of this step, axes of the base
    seq               counts the service's poses
    state             "tracking", "degraded", or "lost": then it is the last good pose
    reason            why, unless tracking; at the start of an epoch, why it began
    epoch             changes whenever a pose is not continuous with the one before
    is_continuous     with the pose that this reader got before; False for its first one, in a new
                      epoch and after the service was started anew: begin afresh
    missed            poses that came since then and that were not read
    heard_s           when it came, on this computer's CLOCK_MONOTONIC
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
        """(3,) x y z in odom."""
        position: Array = self.T_odom_base[:3, 3]
        return position

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) how the base is turned in odom."""
        return quaternion_from_rotation(self.T_odom_base[:3, :3])

    @property
    def age_s(self) -> float:
        """Seconds since it came. The clocks of two computers need not agree for this."""
        return time.monotonic() - self.receive_time_s

    @property
    def is_lost(self) -> bool:
        """True for the last good pose, repeated while tracking is lost."""
        return self.state == LOST


class PoseReader:
    """Turns what was heard into poses for one reader, who may skip some."""

    def __init__(self) -> None:
        self._last: ReceivedPose | None = None

    def read(self, received: ReceivedPose) -> Pose:
        """The pose, with what lies between it and the one that this reader got before."""
        last, self._last = self._last, received
        return make_pose(received, _is_continuous(last, received), _missed_count(last, received))


class ThreadLocalReader(threading.local):
    """A `PoseReader` for every thread that asks for one: what one has read is not news to it."""

    def __init__(self) -> None:
        self.reader = PoseReader()


def make_pose(received: ReceivedPose, is_continuous: bool, missed: int) -> Pose:
    """Message and attachment as one."""
    message, about = received.message, received.attachment
    return Pose(
        stamp_s=message.stamp_s,
        frame_id=message.frame_id,
        child_frame_id=message.child_frame_id,
        T_odom_base=message.T_frame_child,
        pose_covariance=message.pose_covariance,
        twist=message.twist,
        twist_covariance=message.twist_covariance,
        seq=about["seq"],
        state=about["state"],
        reason=about["reason"],
        epoch=about["epoch"],
        is_continuous=is_continuous,
        missed=missed,
        receive_time_s=received.receive_time_s,
    )


def parse_pose_sample(sample: zenoh.Sample, run: int) -> ReceivedPose:
    """What a sample of ``odom`` or ``latest`` says.

    Raises ValueError if it is not a pose, or of a version that this client does not know.
    """
    if sample.attachment is None:
        raise ValueError("a pose came without its attachment")
    about = parse_json(sample.attachment)
    check_fields("a pose", about, _ATTACHMENT_FIELDS)
    return ReceivedPose(decode_odometry(sample.payload.to_bytes()), about, time.monotonic(), run)


def _is_continuous(last: ReceivedPose | None, received: ReceivedPose) -> bool:
    if (
        last is None
        or last.run != received.run
        or received.attachment["seq"] < last.attachment["seq"]
    ):
        return False
    return bool(last.attachment["epoch"] == received.attachment["epoch"])


def _missed_count(last: ReceivedPose | None, received: ReceivedPose) -> int:
    """Numbers begin anew with each run of the service."""
    if last is None or last.run != received.run:
        return 0
    between: int = received.attachment["seq"] - last.attachment["seq"] - 1
    return max(0, between)
