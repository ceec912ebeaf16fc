"""The last tracked views, and the velocity at each: that of a polynomial through poses around it.

The equations of the calibration need velocities that do not depend on the calibration themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.image_pyramid import ImageTiming
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.keyframe_selection import TrackedFrame
from vo_service.odometry.direct.motion import compose, invert, se3_log
from vo_service.odometry.direct.parameters import MAX_POSE_INTERVAL_S, MIN_FRAME_INTERVAL_S

# Poses of a velocity: two before the frame, two after it; of the first two frames, the first ones.
NUM_VELOCITY_POSES = 5
Pose = tuple[float, Array]


@dataclass(eq=False)
class TrackedView:
    """A tracked frame.

    Attributes:
        stamp_s: Of the frame.
        told: The timing that the frame tells.
        calibration: (3,) correction that it was aligned with.
        T_world_camera: 4x4 pose.
        tracked: Its alignment; None if it was not aligned, or is degenerate.
        poses: Stamps and poses around it, and its place there; none while they are not known.
        at: See poses.
    """

    stamp_s: float
    told: ImageTiming
    calibration: Array
    T_world_camera: Array
    tracked: TrackedFrame | None = None
    poses: list[Pose] = field(default_factory=list)
    at: int = 0

    @property
    def has_velocity(self) -> bool:
        """Whether the velocity is known."""
        return bool(self.poses)

    @cached_property
    def velocity(self) -> Array:
        """(6,) twist of the camera in its own axes, m/s and rad/s."""
        return velocity_at(self.poses, self.at)


class ViewHistory:
    """The last views without a gap, and those that have become keyframes."""

    def __init__(self) -> None:
        self._recent: list[TrackedView] = []
        self._by_stamp: dict[float, TrackedView] = {}

    def clear(self) -> None:
        """Forget all views: the next one is the first of another world."""
        self._recent.clear()
        self._by_stamp.clear()

    def interrupt(self) -> None:
        """A frame has no pose: no velocity is computed across it."""
        self._recent.clear()

    def find(self, stamp_s: float) -> TrackedView | None:
        """Find a recent view or a keyframe's by its stamp."""
        return self._by_stamp.get(stamp_s)

    def add(self, view: TrackedView, keyframes: Sequence[DirectKeyframe]) -> TrackedView | None:
        """Add a view; return the one whose velocity is now known.

        Args:
            view: The view.
            keyframes: The keyframes whose views are still needed.
        """
        if self._recent:
            interval_s = view.stamp_s - self._recent[-1].stamp_s
            if not MIN_FRAME_INTERVAL_S <= interval_s <= MAX_POSE_INTERVAL_S:
                self._recent.clear()
        is_begin = len(self._recent) < NUM_VELOCITY_POSES
        self._recent = [*self._recent[1 - NUM_VELOCITY_POSES :], view]
        recent = self._recent
        self._by_stamp[view.stamp_s] = view
        if len(self._by_stamp) > 2 * (len(keyframes) + NUM_VELOCITY_POSES):
            needed = {each.images.stamp_s for each in keyframes} | {v.stamp_s for v in recent}
            self._by_stamp = {s: v for s, v in self._by_stamp.items() if s in needed}
        if len(recent) < NUM_VELOCITY_POSES:
            return None
        poses, middle = [(each.stamp_s, each.T_world_camera) for each in recent], len(recent) // 2
        for at in range(0 if is_begin else middle, middle + 1):
            recent[at].poses, recent[at].at = poses, at
        return recent[middle]


def velocity_at(poses: list[Pose], at: int) -> Array:
    """(6,) velocity of the camera at one of several poses, in its own axes."""
    stamps_s, T_world_cameras = zip(*poses, strict=True)
    return _fit_velocity(np.array(T_world_cameras), np.array(stamps_s) - stamps_s[at], at)


@kernel
def _fit_velocity(T_world_cameras: Array, times_s: Array, at: int) -> Array:
    """(6,) velocity at one pose, of the polynomial through all poses.

    The weights are the derivatives of Lagrange's polynomials.

    Args:
        T_world_cameras: (N, 4, 4) all poses.
        times_s: (N,) their stamps after that of the pose, s.
        at: Index of the pose.
    """
    velocity, T_camera_world = np.zeros(6), invert(T_world_cameras[at])
    for i in range(len(times_s)):
        if i == at:
            continue
        weight = 1.0 / times_s[i]
        for j in range(len(times_s)):
            if j not in (i, at):
                weight *= -times_s[j] / (times_s[i] - times_s[j])
        velocity += weight * se3_log(compose(T_camera_world, T_world_cameras[i]))
    return velocity
