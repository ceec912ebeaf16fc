"""One message of the wheels' odometry, checked."""

import math
from dataclasses import dataclass

import numpy as np

from drivers.ros_messages.cdr import BytesLike
from drivers.ros_messages.decoding import decode_odometry
from drivers.ros_messages.navigation import OdometryMessage, encode_odometry
from vo_service.wheel_odometry.planar_pose import PlanarPose, PlanarTwist, planar_part

# Many drivers send 0 for what they do not know, or 1e6; m^2/s^2 and rad^2/s^2.
MIN_TWIST_VARIANCE, MAX_TWIST_VARIANCE = 1e-8, 1.0
TwistVariances = tuple[float | None, float | None, float | None]
# Indices of forward, left and yaw in a twist.
PLANAR_AXES = (0, 1, 5)
# Larger positions are in other units, or not numbers of a robot.
MAX_POSITION_M = 1e6


@dataclass(frozen=True)
class WheelReading:
    """A pose of the base by its wheels.

    Attributes:
        stamp_s: Its stamp, Unix seconds.
        frame_ids: Parent frame and frame of the base.
        pose: The pose in the wheels' own odometry frame.
        twist: The velocity of the base.
        twist_variances: Of forward, left and yaw; None where the driver does not tell it.
    """

    stamp_s: float
    frame_ids: tuple[str, str]
    pose: PlanarPose
    twist: PlanarTwist
    twist_variances: TwistVariances = (None, None, None)


def parse_wheel_reading(payload: BytesLike) -> WheelReading:
    """Parse a CDR ``nav_msgs/msg/Odometry``.

    Raises:
        ValueError: It is not such a message, or its pose is not one.
    """
    message = decode_odometry(payload)
    pose = planar_part(message.T_frame_child)
    twist = PlanarTwist(*(float(message.twist[axis]) for axis in PLANAR_AXES))
    if not all(map(math.isfinite, (*pose, *twist))):
        raise ValueError("its pose or twist has a number that is not finite")
    if message.stamp_s < 0.0:
        raise ValueError(f"its stamp is {message.stamp_s:g} s, before 1970")
    if pose.distance_m > MAX_POSITION_M:
        raise ValueError(f"its position is {pose.distance_m:g} m away: positions are in meters")
    forward, left, yaw = (
        _known_variance(float(message.twist_covariance[axis, axis])) for axis in PLANAR_AXES
    )
    frame_ids = message.frame_id, message.child_frame_id
    return WheelReading(message.stamp_s, frame_ids, pose, twist, (forward, left, yaw))


def encode_wheel_reading(reading: WheelReading) -> bytes:
    """Encode a reading as CDR ``nav_msgs/msg/Odometry``.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
    """
    twist, twist_covariance = np.zeros(6), np.zeros((6, 6))
    axes = list(PLANAR_AXES)
    twist[axes] = reading.twist
    twist_covariance[axes, axes] = [variance or 0.0 for variance in reading.twist_variances]
    frame_id, child_frame_id = reading.frame_ids
    return encode_odometry(
        OdometryMessage(
            stamp_s=reading.stamp_s,
            frame_id=frame_id,
            child_frame_id=child_frame_id,
            T_frame_child=reading.pose.transform(),
            pose_covariance=np.zeros((6, 6)),
            twist=twist,
            twist_covariance=twist_covariance,
        )
    )


def _known_variance(variance: float) -> float | None:
    return variance if MIN_TWIST_VARIANCE <= variance <= MAX_TWIST_VARIANCE else None
