"""Poses and motions in the plane: SE(2) with its exponential, its logarithm and interpolation."""

import math
from typing import NamedTuple

from drivers.core.geometry import Array, rigid_transform, so3_exp

# Below this angle, the terms of the exponential are those of a straight line.
_STRAIGHT_RAD = 1e-9


class PlanarPose(NamedTuple):
    """A pose in the plane; also a motion, which is the pose that it leads to from the origin.

    Attributes:
        x_m: Position, forward of the parent frame.
        y_m: Position, left of it.
        yaw_rad: Angle, counterclockwise.
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def then(self, motion: "PlanarPose") -> "PlanarPose":
        """Return the pose after a motion, which is in the axes of this pose."""
        cosine, sine = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return PlanarPose(
            self.x_m + cosine * motion.x_m - sine * motion.y_m,
            self.y_m + sine * motion.x_m + cosine * motion.y_m,
            wrap_angle(self.yaw_rad + motion.yaw_rad),
        )

    def motion_to(self, other: "PlanarPose") -> "PlanarPose":
        """Return the motion from this pose to another one, in the axes of this pose."""
        cosine, sine = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        dx, dy = other.x_m - self.x_m, other.y_m - self.y_m
        return PlanarPose(
            cosine * dx + sine * dy,
            cosine * dy - sine * dx,
            wrap_angle(other.yaw_rad - self.yaw_rad),
        )

    def toward(self, other: "PlanarPose", share: float) -> "PlanarPose":
        """Return the pose after a share (0 to 1) of the way to another pose, at constant twist."""
        return self.then(self.motion_to(other).velocity(1.0).motion(share))

    def velocity(self, duration_s: float) -> "PlanarTwist":
        """Return the constant twist that makes this motion: its logarithm by time."""
        half = 0.5 * self.yaw_rad
        along = 1.0 if abs(half) < _STRAIGHT_RAD else half / math.tan(half)
        return PlanarTwist(
            (along * self.x_m + half * self.y_m) / duration_s,
            (along * self.y_m - half * self.x_m) / duration_s,
            self.yaw_rad / duration_s,
        )

    @property
    def distance_m(self) -> float:
        """Length of the motion's translation."""
        return math.hypot(self.x_m, self.y_m)

    def transform(self) -> Array:
        """Return the 4x4 transform, with z up."""
        return rigid_transform(so3_exp([0.0, 0.0, self.yaw_rad]), [self.x_m, self.y_m, 0.0])


class PlanarTwist(NamedTuple):
    """Velocity in the plane, in the axes of what moves.

    Attributes:
        forward_m_s: Along x.
        left_m_s: Along y.
        yaw_rad_s: About z, counterclockwise.
    """

    forward_m_s: float
    left_m_s: float
    yaw_rad_s: float

    @property
    def speed_m_s(self) -> float:
        """Length of the linear velocity."""
        return math.hypot(self.forward_m_s, self.left_m_s)

    def motion(self, duration_s: float) -> PlanarPose:
        """Return the motion at this twist for a time: the exponential."""
        yaw_rad = self.yaw_rad_s * duration_s
        half = 0.5 * yaw_rad
        # sin(yaw) / yaw and (1 - cos(yaw)) / yaw, exact down to a zero angle.
        chord = 1.0 if abs(half) < _STRAIGHT_RAD else math.sin(half) / half
        along, across = chord * math.cos(half), chord * math.sin(half)
        return PlanarPose(
            (along * self.forward_m_s - across * self.left_m_s) * duration_s,
            (across * self.forward_m_s + along * self.left_m_s) * duration_s,
            wrap_angle(yaw_rad),
        )


def wrap_angle(angle_rad: float) -> float:
    """Return the same angle from -pi to pi."""
    return math.remainder(angle_rad, math.tau)


def planar_part(T: Array) -> PlanarPose:
    """Return x, y and yaw of a 4x4 transform."""
    return PlanarPose(float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0]))
