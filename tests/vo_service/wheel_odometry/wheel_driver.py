"""A driver of wheels for tests: messages of a drive at a constant twist."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from vo_service.config_tables import WheelOdometryConfig
from vo_service.wheel_odometry.planar_pose import PlanarPose, PlanarTwist
from vo_service.wheel_odometry.wheel_odometry import WheelMotion, WheelOdometry
from vo_service.wheel_odometry.wheel_reading import (
    TwistVariances,
    WheelReading,
    encode_wheel_reading,
)

START_S = 1_700_000_000.0
FRAME_S = 1 / 30
PERIOD_S = 0.02
CURVE = PlanarTwist(0.3, 0.0, 0.5)


def wheel_odometry(**changes: Any) -> WheelOdometry:
    """Make the object under test; `changes` are keys of its table."""
    return WheelOdometry(WheelOdometryConfig(True, **changes), "kinect/wheel_odom")


def wheel_message(
    stamp_s: float,
    pose: PlanarPose,
    twist: PlanarTwist,
    frame_id: str = "wheel_odom",
    variances: TwistVariances = (None, None, None),
) -> bytes:
    """Encode a message of a driver."""
    frame_ids = (frame_id, "base_link")
    return encode_wheel_reading(WheelReading(stamp_s, frame_ids, pose, twist, variances))


def pose_at(time_s: float, twist: PlanarTwist = CURVE) -> PlanarPose:
    """Where the drive is, which begins somewhere in the wheels' frame."""
    return PlanarPose(3.0, -2.0, 2.5).then(twist.motion(time_s))


def drive(
    wheels: WheelOdometry,
    times_s: Iterable[float],
    twist: PlanarTwist = CURVE,
    offset_s: float = 0.0,
    **changes: Any,
) -> None:
    """Send the poses at some times after the start, with an offset of the driver's clock."""
    for time_s in times_s:
        stamp_s = START_S + time_s + offset_s
        wheels.add_message(wheel_message(stamp_s, pose_at(time_s, twist), twist, **changes))


def times(begin_s: float, end_s: float, period_s: float = PERIOD_S) -> list[float]:
    """Times of messages, without the end."""
    return np.arange(begin_s, end_s - 1e-9, period_s).tolist()


def run(
    wheels: WheelOdometry, begin_s: float, end_s: float, **changes: Any
) -> list[WheelMotion | None]:
    """Send messages, and ask for the motion of each frame, as the service does."""
    motions = []
    sent_s = begin_s
    for frame_s in times(begin_s, end_s, FRAME_S):
        drive(wheels, times(sent_s, frame_s), **changes)
        sent_s += len(times(sent_s, frame_s)) * PERIOD_S
        motions.append(ask(wheels, frame_s))
    return motions


def ask(wheels: WheelOdometry, frame_s: float) -> WheelMotion | None:
    """Ask for the motion since the frame before."""
    return wheels.motion_between(START_S + frame_s - FRAME_S, START_S + frame_s)
