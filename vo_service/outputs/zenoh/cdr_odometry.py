"""ROS 2's ``nav_msgs/msg/Odometry`` as plain CDR bytes, without ROS."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, quaternion_from_rotation, transform_from_pose
from vo_service.outputs.zenoh.cdr_encoding import (
    CDR_HEADER,
    append_frames,
    append_numbers,
    read_frames,
    read_numbers,
    reraise_as_value_error,
    strip_header,
)

ODOMETRY_SCHEMA = "nav_msgs/msg/Odometry"

# position 3, quaternion 4, covariance 36, twist 6, covariance 36
_NUMBERS = 85


@dataclass(frozen=True)
class OdometryMessage:
    """One odometry message.

    Attributes:
        stamp_s: stamp of the pose, Unix seconds.
        frame_id: parent frame of the pose.
        child_frame_id: frame that moves; the twist is in its axes.
        T_frame_child: 4x4 pose, meters.
        pose_covariance: 6x6, order x y z rx ry rz, axes of `frame_id`.
        twist: (6,) m/s and rad/s.
        twist_covariance: 6x6.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_frame_child: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array

    @property
    def position_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        position: Array = self.T_frame_child[:3, 3]
        return position

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_odometry(message: OdometryMessage) -> bytes:
    """Encode a message as CDR.

    Raises:
        ValueError: a number is not finite, or the stamp does not fit.
    """
    numbers = np.concatenate(
        [
            message.position_m,
            message.quaternion_xyzw,
            message.pose_covariance.ravel(),
            message.twist,
            message.twist_covariance.ravel(),
        ]
    )
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"odometry at {message.stamp_s} s has a number that is not finite")
    body = append_frames(b"", message.stamp_s, message.frame_id, message.child_frame_id)
    return CDR_HEADER + append_numbers(body, numbers)


def decode_odometry(payload: bytes) -> OdometryMessage:
    """Decode a message from `encode_odometry` or any ROS 2 node.

    Raises:
        ValueError: the bytes are not a little-endian Odometry message.
    """
    body = strip_header(payload)
    with reraise_as_value_error(ODOMETRY_SCHEMA):
        stamp_s, frame_id, child_frame_id, offset = read_frames(body)
        numbers = read_numbers(body, offset, _NUMBERS)
    return OdometryMessage(
        stamp_s=stamp_s,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        T_frame_child=transform_from_pose(numbers[:3], numbers[3:7]),
        pose_covariance=numbers[7:43].reshape(6, 6),
        twist=numbers[43:49],
        twist_covariance=numbers[49:85].reshape(6, 6),
    )
