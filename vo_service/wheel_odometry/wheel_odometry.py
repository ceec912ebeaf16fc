"""The motion of the base by its wheels, from messages of their driver."""

import math
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.core.geometry import Array
from drivers.recording.odometry import OdometryRecord
from vo_service.config_tables import WheelOdometryConfig
from vo_service.wheel_odometry.planar_pose import planar_part
from vo_service.wheel_odometry.pose_history import PoseHistory, WheelState
from vo_service.wheel_odometry.slip_detector import SlipDetector
from vo_service.wheel_odometry.stamp_offset import StampOffset
from vo_service.wheel_odometry.wheel_faults import ArrivalFault, FaultLog, TimedFault
from vo_service.wheel_odometry.wheel_reading import PLANAR_AXES, parse_wheel_reading

# What a base moves besides, from one frame to the next: bumps, and the wheels' resolution.
FRAME_S = 1 / 30
TRANSLATION_FLOOR_M, ROTATION_FLOOR_RAD = 0.0005, 0.001
VERTICAL_SIGMA_M, TILT_SIGMA_RAD = 0.002, math.radians(0.2)
# Messages that a recording may be late by.
MAX_JOURNAL = 1000
# Standard deviation of the motion to the side, relative to that of the motion ahead.
LATERAL_SHARE = 0.4


@dataclass(frozen=True)
class WheelMotion:
    """Motion of the base between two times, by its wheels.

    Attributes:
        T_from_to: 4x4 pose of the base at the end, in the base at the begin: x, y and yaw.
        sigmas: (6,) standard deviations in the axes of the base, m and rad: x y z rx ry rz.
    """

    T_from_to: Array
    sigmas: Array


class MessageJournal:
    """The messages since they were last taken, the newest `MAX_JOURNAL` of them. Thread-safe."""

    def __init__(self) -> None:
        self._messages: deque[OdometryRecord] = deque(maxlen=MAX_JOURNAL)

    def add(self, message: OdometryRecord) -> None:
        """Add a message."""
        self._messages.append(message)

    def take(self) -> list[OdometryRecord]:
        """Take all messages, the oldest first."""
        return [self._messages.popleft() for _ in range(len(self._messages))]


class NullWheelOdometry:
    """No wheels: no motion is known."""

    warning = ""

    def open_journal(self) -> MessageJournal:
        """Return a journal that stays empty."""
        return MessageJournal()

    def motion_between(self, from_s: float, to_s: float) -> WheelMotion | None:
        """Return None."""
        return None

    def add_visual_motion(self, *_motion: Any, is_well_constrained: bool) -> None:
        """Ignore the motion."""


class WheelOdometry:
    """Keeps the last seconds of the wheels' poses. Thread-safe; no message raises an exception.

    Times are stamps of the published clock; the last frame's is the present. How much the stamps of
    the wheels are off is learned.

    Args:
        config: Standard deviations, and the age of poses that are not used.
        source: Where the messages come from, for people, such as "kinect/wheel_odom".
    """

    def __init__(self, config: WheelOdometryConfig, source: str) -> None:
        self._config, self._source = config, source
        self._lock = threading.Lock()
        self._history = PoseHistory(config.max_age_s)
        self._slip = SlipDetector()
        self._offset = StampOffset()
        self._journals: list[MessageJournal] = []
        self._messages = 0
        self._arrival = ArrivalFault(source, config.max_age_s)
        self._unreadable, self._jump, self._slipping = TimedFault(), TimedFault(), TimedFault()
        self._log = FaultLog()

    @property
    def warning(self) -> str:
        """The present fault; "" if there is none."""
        with self._lock:
            return self._warning()

    def open_journal(self) -> "MessageJournal":
        """Open a journal of the messages from now on, for a recording."""
        journal = MessageJournal()
        with self._lock:
            self._journals.append(journal)
        return journal

    def add_message(self, payload: bytes) -> float | None:
        """Add a message of the driver, CDR ``nav_msgs/msg/Odometry``. Does not block.

        Returns:
            Its stamp; None if it is not used.
        """
        try:
            reading = parse_wheel_reading(payload)
        except ValueError as error:
            with self._lock:
                self._messages += 1
                self._unreadable.set(f"a message on {self._source} is not used: {error}")
            return None
        with self._lock:
            self._messages += 1
            if fault := self._history.add(reading):
                self._jump.set(f"{fault}; wheel odometry restarts there")
            for journal in self._journals:
                journal.add(OdometryRecord(reading.stamp_s, payload))
        return reading.stamp_s

    def motion_between(self, from_s: float, to_s: float) -> WheelMotion | None:
        """Return the base's motion between two frames. Call it at each frame: faults need its time.

        Args:
            from_s: Stamp of an earlier frame.
            to_s: Stamp of the present frame.

        Returns:
            The motion; None if the wheels' poses do not cover it, or cannot be trusted.
        """
        with self._lock:
            self._arrival.advance(to_s, self._history.newest_s, self._messages)
            for fault in (self._unreadable, self._jump, self._slipping):
                fault.advance(to_s)
            if warning := self._warning():
                self._log.add(warning, to_s)
            return self._motion(from_s, to_s, self._slip.factor(to_s))

    def add_visual_motion(
        self,
        from_s: float,
        to_s: float,
        T_from_to: Array,
        covariance: Array,
        *,
        is_well_constrained: bool,
    ) -> None:
        """Compare the wheels with the camera's own motion, to find out whether they slip.

        Args:
            from_s: Stamp of the frame before.
            to_s: Stamp of the present frame.
            T_from_to: 4x4 motion of the base, without use of the wheels.
            covariance: 6x6 of it in the axes of the base, x y z rx ry rz.
            is_well_constrained: Whether the view alone determines the motion.
        """
        with self._lock:
            motion = self._motion(from_s, to_s, slip_factor=1.0)
            if motion is None or not is_well_constrained:
                self._slip.skip()
                return
            wheels, camera = planar_part(motion.T_from_to), planar_part(T_from_to)
            newest_s = self._history.newest_s
            if newest_s is not None:
                self._offset.add(from_s, to_s, camera.yaw_rad, newest_s, self._yaw_rate)
            axes = list(PLANAR_AXES)
            variances = motion.sigmas[axes] ** 2 + np.diag(covariance)[axes]
            errors = np.abs(wheels.motion_to(camera)) / np.sqrt(variances)
            if self._slip.add(to_s, float(errors.max())):
                self._slipping.set(
                    f"the wheels slip: they tell {1e3 * wheels.distance_m:.0f} mm and "
                    f"{math.degrees(wheels.yaw_rad):.1f} deg from a frame to the next, the camera "
                    f"{1e3 * camera.distance_m:.0f} mm and {math.degrees(camera.yaw_rad):.1f} deg"
                )

    def _motion(self, from_s: float, to_s: float, slip_factor: float) -> WheelMotion | None:
        if self._arrival.is_offset or to_s < from_s:
            return None
        offset_s = self._offset.value_s
        begin = self._history.state_at(from_s + offset_s)
        end = self._history.state_at(to_s + offset_s)
        if begin is None or end is None:
            return None
        sigmas = self._sigmas(begin, end, to_s - from_s)
        sigmas[list(PLANAR_AXES)] *= slip_factor
        return WheelMotion(begin.pose.motion_to(end.pose).transform(), sigmas)

    def _yaw_rate(self, from_s: float, to_s: float) -> float | None:
        """Mean yaw rate between two stamps of the wheels, rad/s; None if it is not known."""
        begin, end = self._history.state_at(from_s), self._history.state_at(to_s)
        if begin is None or end is None:
            return None
        return begin.pose.motion_to(end.pose).yaw_rad / (to_s - from_s)

    def _sigmas(self, begin: WheelState, end: WheelState, duration_s: float) -> Array:
        """Return standard deviations: a share of the path, or those of the driver's twist."""
        distance_m = end.distance_m - begin.distance_m
        shares = (
            self._config.translation_sigma * distance_m,
            LATERAL_SHARE * self._config.translation_sigma * distance_m,
            self._config.rotation_sigma * (end.turn_rad - begin.turn_rad),
        )
        x_m, y_m, yaw_rad = (
            share if variance is None else math.sqrt(variance) * duration_s
            for share, variance in zip(shares, end.reading.twist_variances, strict=True)
        )
        # What the base may have moved since its pose is no longer known.
        unknown_s = end.unknown_s - begin.unknown_s
        floor_m = end.velocity.speed_m_s * unknown_s + TRANSLATION_FLOOR_M
        yaw_rad += abs(end.velocity.yaw_rad_s) * unknown_s + ROTATION_FLOOR_RAD
        y_m += 0.5 * distance_m * yaw_rad  # a wrong yaw turns the path
        frames = math.sqrt(max(1.0, duration_s / FRAME_S))
        z_m, tilt_rad = VERTICAL_SIGMA_M * frames, TILT_SIGMA_RAD * frames
        return np.array([x_m + floor_m, y_m + floor_m, z_m, tilt_rad, tilt_rad, yaw_rad])

    def _warning(self) -> str:
        faults = (
            self._unreadable.text,
            self._jump.text,
            self._arrival.text,
            self._slipping.text,
        )
        fault = next(filter(None, faults), "")
        return fault and f"wheel odometry: {fault}"


# The wheels, or none.
WheelOdometrySource = WheelOdometry | NullWheelOdometry
