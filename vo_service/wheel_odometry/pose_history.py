"""The last seconds of the wheels' poses, and the pose at any time in them."""

import math
from bisect import bisect_left
from dataclasses import dataclass
from operator import attrgetter

from vo_service.wheel_odometry.planar_pose import PlanarPose, PlanarTwist
from vo_service.wheel_odometry.wheel_reading import WheelReading

KEPT_S = 10.0
# The pose goes on at the last velocity for so long.
MAX_EXTRAPOLATION_S = 0.05
# A base that is driven moves less from one reading to the next; what is added covers stamps that
# are not those of the pose.
MAX_SPEED_M_S, MAX_YAW_RATE_RAD_S = 5.0, 10.0
JUMP_MARGIN_M, JUMP_MARGIN_RAD = 0.05, 0.1
# A clock counts as set back when so many stamps in a row are before the newest one.
MAX_STALE_READINGS = 5
# A twist that differs by more from the last two poses is not in m/s and rad/s, or not filled in.
MAX_ACCELERATION_M_S2, MAX_ACCELERATION_RAD_S2 = 3.0, 10.0
MAX_RATE_ERROR = 0.25


@dataclass(frozen=True)
class _Sample:
    """A reading, and the way to it since the history began."""

    reading: WheelReading
    distance_m: float = 0.0
    turn_rad: float = 0.0

    @property
    def stamp_s(self) -> float:
        return self.reading.stamp_s


@dataclass(frozen=True)
class WheelState:
    """The wheels at one time.

    Attributes:
        pose: Pose in the wheels' odometry frame.
        distance_m: Length of the path since the history began.
        turn_rad: Angle turned, to either side, since then.
        velocity: The velocity there.
        unknown_s: Time without knowledge before, in which the pose is that of its begin.
        reading: The reading there or before.
    """

    pose: PlanarPose
    distance_m: float
    turn_rad: float
    velocity: PlanarTwist
    unknown_s: float
    reading: WheelReading


class PoseHistory:
    """Poses of one drive, in order of their stamps. A jump or a clock that was set restarts it.

    Args:
        max_gap_s: Longest time from one pose to the next with poses between them.
    """

    def __init__(self, max_gap_s: float) -> None:
        self._max_gap_s = max_gap_s
        self._samples: list[_Sample] = []
        self._stale = 0

    @property
    def newest_s(self) -> float | None:
        """Stamp of the newest pose; None without one."""
        return self._samples[-1].stamp_s if self._samples else None

    def add(self, reading: WheelReading) -> str:
        """Add the next reading; one that is not newer than the last is ignored.

        Returns:
            Why the history has restarted; "" if it has not.
        """
        if not self._samples:
            self._samples = [_Sample(reading)]
            return ""
        last = self._samples[-1]
        step_s = reading.stamp_s - last.stamp_s
        if step_s <= 0.0:
            return self._add_stale(reading, -step_s)
        self._stale = 0
        motion = last.reading.pose.motion_to(reading.pose)
        if (
            motion.distance_m > JUMP_MARGIN_M + MAX_SPEED_M_S * step_s
            or abs(motion.yaw_rad) > JUMP_MARGIN_RAD + MAX_YAW_RATE_RAD_S * step_s
        ):  # no base can move so in this time
            self._samples = [_Sample(reading)]
            return (
                f"the pose jumped by {motion.distance_m:.2f} m and "
                f"{math.degrees(abs(motion.yaw_rad)):.0f} deg in {step_s:.2f} s"
            )
        distance_m = last.distance_m + motion.distance_m
        self._samples.append(_Sample(reading, distance_m, last.turn_rad + abs(motion.yaw_rad)))
        oldest_s = reading.stamp_s - KEPT_S
        del self._samples[: bisect_left(self._samples, oldest_s, key=attrgetter("stamp_s"))]
        return ""

    def state_at(self, stamp_s: float) -> WheelState | None:
        """Return the state at a time; None if the poses around it are too far away or missing."""
        after = bisect_left(self._samples, stamp_s, key=attrgetter("stamp_s"))
        if after == len(self._samples):
            return self._extrapolate(stamp_s)
        if self._samples[after].stamp_s == stamp_s:
            return _state(self._samples[after], self._velocity(after))
        if after == 0:
            return None
        return self._interpolate(after, stamp_s)

    def _interpolate(self, after: int, stamp_s: float) -> WheelState | None:
        one, other = self._samples[after - 1 : after + 1]
        step_s = other.stamp_s - one.stamp_s
        if step_s > self._max_gap_s:
            return None
        share = (stamp_s - one.stamp_s) / step_s
        return WheelState(
            one.reading.pose.toward(other.reading.pose, share),
            one.distance_m + share * (other.distance_m - one.distance_m),
            one.turn_rad + share * (other.turn_rad - one.turn_rad),
            self._velocity(after),
            0.0,
            one.reading,
        )

    def _extrapolate(self, stamp_s: float) -> WheelState | None:
        if not self._samples or stamp_s - self._samples[-1].stamp_s > self._max_gap_s:
            return None
        age_s = stamp_s - self._samples[-1].stamp_s
        state = _state(self._samples[-1], self._velocity(len(self._samples) - 1))
        known_s = min(age_s, MAX_EXTRAPOLATION_S)
        motion = state.velocity.motion(known_s)
        return WheelState(
            state.pose.then(motion),
            state.distance_m + motion.distance_m,
            state.turn_rad + abs(motion.yaw_rad),
            state.velocity,
            age_s - known_s,
            state.reading,
        )

    def _velocity(self, index: int) -> PlanarTwist:
        """Return a reading's twist, or that of the step to it if they contradict each other."""
        reading = self._samples[index].reading
        if index == 0:
            return PlanarTwist(0.0, 0.0, 0.0)
        before = self._samples[index - 1].reading
        step_s = reading.stamp_s - before.stamp_s
        rate = before.pose.motion_to(reading.pose).velocity(step_s)
        is_filled_in = any(reading.twist)
        return reading.twist if is_filled_in and _agree(reading.twist, rate, step_s) else rate

    def _add_stale(self, reading: WheelReading, back_s: float) -> str:
        if back_s == 0.0:  # sent twice, or the driver has stopped
            return ""
        self._stale += 1
        if self._stale < MAX_STALE_READINGS:
            return ""
        self._samples, self._stale = [_Sample(reading)], 0
        return f"its clock was set back by {back_s:.2f} s"


def _state(sample: _Sample, velocity: PlanarTwist) -> WheelState:
    reading = sample.reading
    return WheelState(reading.pose, sample.distance_m, sample.turn_rad, velocity, 0.0, reading)


def _agree(twist: PlanarTwist, rate: PlanarTwist, step_s: float) -> bool:
    linear_m_s = MAX_ACCELERATION_M_S2 * step_s + MAX_RATE_ERROR * rate.speed_m_s
    angular_rad_s = MAX_ACCELERATION_RAD_S2 * step_s + MAX_RATE_ERROR * abs(rate.yaw_rad_s)
    return (
        abs(twist.forward_m_s - rate.forward_m_s) <= linear_m_s
        and abs(twist.left_m_s - rate.left_m_s) <= linear_m_s
        and abs(twist.yaw_rad_s - rate.yaw_rad_s) <= angular_rad_s
    )
