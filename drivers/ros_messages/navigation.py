"""Odometry and transforms as ROS 2 messages."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, quaternion_from_rotation
from drivers.ros_messages.cdr import CdrWriter, StampSeconds

ODOMETRY_SCHEMA = "nav_msgs/msg/Odometry"
TRANSFORM_SCHEMA = "geometry_msgs/msg/TransformStamped"
TWIST_SCHEMA = "geometry_msgs/msg/Twist"
TRANSFORMS_SCHEMA = "tf2_msgs/msg/TFMessage"
POSE_SCHEMA = "geometry_msgs/msg/PoseStamped"
VECTOR_SCHEMA = "geometry_msgs/msg/Vector3Stamped"


@dataclass(frozen=True)
class TransformMessage:
    """Transform between two frames.

    Attributes:
        stamp_s: Stamp of the transform, Unix seconds.
        frame_id: Parent frame.
        child_frame_id: Frame that moves.
        T_frame_child: 4x4, meters.
    """

    stamp_s: StampSeconds
    frame_id: str
    child_frame_id: str
    T_frame_child: Array

    @property
    def position_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        return self.T_frame_child[:3, 3]

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


@dataclass(frozen=True)
class OdometryMessage(TransformMessage):
    """A pose and a velocity, with their covariances.

    Attributes:
        pose_covariance: 6x6, order x y z rx ry rz, axes of `frame_id`.
        twist: (6,) m/s and rad/s, in axes of `child_frame_id`.
        twist_covariance: 6x6.
    """

    stamp_s: float
    pose_covariance: Array
    twist: Array
    twist_covariance: Array


def encode_odometry(message: OdometryMessage) -> bytes:
    """Encode a message as CDR.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
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
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.child_frame_id)
    writer.float64s(numbers)
    return writer.to_bytes()


def encode_twist(twist: Array) -> bytes:
    """Encode a velocity (6,), m/s and rad/s, as CDR ``geometry_msgs/msg/Twist``.

    Raises:
        ValueError: A number is not finite.
    """
    if not np.all(np.isfinite(twist)):
        raise ValueError("a velocity has a number that is not finite")
    writer = CdrWriter()
    writer.float64s(twist)
    return writer.to_bytes()


def encode_transform(message: TransformMessage) -> bytes:
    """Encode a ``TransformStamped`` as CDR.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
    """
    writer = CdrWriter()
    _write_transform(writer, message)
    return writer.to_bytes()


def encode_transforms(messages: Sequence[TransformMessage]) -> bytes:
    """Encode transforms as one ``TFMessage``. Raises as `encode_transform`."""
    writer = CdrWriter()
    writer.uint32(len(messages))
    for message in messages:
        _write_transform(writer, message)
    return writer.to_bytes()


def _write_transform(writer: CdrWriter, message: TransformMessage) -> None:
    if not np.all(np.isfinite(message.T_frame_child)):
        raise ValueError(f"transform at {message.stamp_s} s has a number that is not finite")
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.child_frame_id)
    writer.float64s(np.concatenate([message.position_m, message.quaternion_xyzw]))


def encode_pose(stamp_s: StampSeconds, frame_id: str, T_frame_body: Array) -> bytes:
    """Encode a pose (4x4, meters) as a ``PoseStamped`` in CDR."""
    quaternion = quaternion_from_rotation(T_frame_body[:3, :3])
    return _encode_numbers(stamp_s, frame_id, np.concatenate([T_frame_body[:3, 3], quaternion]))


def encode_vector(stamp_s: StampSeconds, frame_id: str, vector: Sequence[float]) -> bytes:
    """Encode a vector of 3 numbers as a ``Vector3Stamped`` in CDR."""
    return _encode_numbers(stamp_s, frame_id, np.array(vector))


def _encode_numbers(stamp_s: StampSeconds, frame_id: str, numbers: Array) -> bytes:
    writer = CdrWriter()
    writer.header(stamp_s, frame_id)
    writer.float64s(numbers)
    return writer.to_bytes()


OCCUPANCY_GRID_SCHEMA = "nav_msgs/msg/OccupancyGrid"


@dataclass(frozen=True)
class OccupancyGridMessage:
    """A map of cells.

    Attributes:
        stamp_s: Time of the map, Unix seconds.
        frame_id: Frame of the map.
        resolution_m: Side of a cell.
        origin_xy_m: Lower corner of the first cell.
        cells: (height, width) int8: 0 = free, 100 = occupied, -1 = unknown; the first row has the
            least y, the first column the least x.
    """

    stamp_s: float
    frame_id: str
    resolution_m: float
    origin_xy_m: tuple[float, float]
    cells: NDArray[np.int8]


def encode_occupancy_grid(message: OccupancyGridMessage) -> bytes:
    """Encode a map as CDR.

    Raises:
        ValueError: The stamp does not fit, or the origin is not finite.
    """
    if not np.all(np.isfinite(message.origin_xy_m)):
        raise ValueError(f"the map at {message.stamp_s} s has an origin that is not finite")
    height, width = message.cells.shape
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.time(0.0)  # map_load_time
    writer.float32s(np.array([message.resolution_m]))
    writer.uint32(width, height)
    writer.float64s(np.array([*message.origin_xy_m, 0.0, 0.0, 0.0, 0.0, 1.0]))
    writer.byte_sequence(message.cells.tobytes())
    return writer.to_bytes()
