"""Recent frames with their poses, from which the velocity at each of them follows."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import compose, se3_log
from vo_service.odometry.direct.parameters import MAX_POSE_INTERVAL_S

# Poses of a velocity: two before the frame, two after it.
NUM_VELOCITY_POSES = 5
# Of the first frame, which has none before it.
NUM_FIRST_VELOCITY_POSES = 4


@dataclass(frozen=True)
class TimedFrame:
    """A frame with the timing that it tells.

    Attributes:
        frame: The frame as it came from the camera.
        told: (2,) its readout and the delay of depth after color, s.
    """

    frame: RgbdFrame
    told: Array

    @classmethod
    def of(cls, frame: RgbdFrame) -> "TimedFrame":
        """Make it from a frame of a camera."""
        return cls(frame, np.array([frame.readout_s, frame.skew_s]))

    def with_correction(self, correction: Array) -> RgbdFrame:
        """Return the frame with a corrected timing; the readout is at least zero."""
        readout_s, skew_s = (self.told + correction).tolist()
        return replace(self.frame, readout_s=max(readout_s, 0.0), skew_s=skew_s)


@dataclass
class TrackedView:
    """A tracked frame; the alignment is dropped once it is used.

    Attributes:
        stamp_s: Of the frame.
        T_world_camera: 4x4 pose.
        told: (2,) timing that the frame tells, s.
        timing: (2,) correction that it was aligned with, s.
        keyframe: The keyframe that it was aligned with; None if it was not aligned.
        alignment: The alignment.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s; None while unknown.
        is_first: Whether it is the first one of its world.
    """

    stamp_s: float
    T_world_camera: Array
    told: Array
    timing: Array
    keyframe: DirectKeyframe | None
    alignment: DirectAlignment | None
    velocity: Array | None = None
    is_first: bool = False

    @classmethod
    def without_alignment(
        cls, timed: TimedFrame, T_world_camera: Array, timing: Array
    ) -> "TrackedView":
        """Make the view of a frame that was aligned with nothing."""
        return cls(timed.frame.stamp_s, T_world_camera, timed.told, timing, None, None)


class ViewHistory:
    """The last views without a gap, and those that have become keyframes."""

    def __init__(self) -> None:
        self._recent: deque[TrackedView] = deque(maxlen=NUM_VELOCITY_POSES + 2)
        self._by_stamp: dict[float, TrackedView] = {}
        self._is_empty = True

    def clear(self) -> None:
        """Forget all views: the next one is the first of another world."""
        self._recent.clear()
        self._by_stamp.clear()
        self._is_empty = True

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
        if self._recent and view.stamp_s - self._recent[-1].stamp_s > MAX_POSE_INTERVAL_S:
            self._recent.clear()
        view.is_first, self._is_empty = self._is_empty, False
        self._recent.append(view)
        self._by_stamp[view.stamp_s] = view
        self._forget_all_but({keyframe.images.stamp_s for keyframe in keyframes})
        views = list(self._recent)
        if views[0].is_first and len(views) == NUM_FIRST_VELOCITY_POSES:
            views[0].velocity = velocity_at(views, 0)
        if len(views) < NUM_VELOCITY_POSES:
            return None
        last = views[-NUM_VELOCITY_POSES:]
        middle = last[NUM_VELOCITY_POSES // 2]
        middle.velocity = velocity_at(last, NUM_VELOCITY_POSES // 2)
        return middle

    def _forget_all_but(self, keyframe_stamps_s: set[float]) -> None:
        recent_stamps_s = {view.stamp_s for view in self._recent}
        for stamp_s in self._by_stamp.keys() - recent_stamps_s - keyframe_stamps_s:
            del self._by_stamp[stamp_s]


def velocity_at(views: Sequence[TrackedView], at: int) -> Array:
    """(6,) velocity of the camera at one of several views, in its own axes."""
    now = views[at]
    T_world_cameras = np.array([view.T_world_camera for view in views])
    times_s = np.array([view.stamp_s for view in views]) - now.stamp_s
    return _fit_velocity(inverse(now.T_world_camera), T_world_cameras, times_s, at)


@kernel
def _fit_velocity(T_camera_world: Array, T_world_cameras: Array, times_s: Array, at: int) -> Array:
    """(6,) velocity at one pose, of the polynomial through all poses.

    The weights are the derivatives of Lagrange's polynomials.

    Args:
        T_camera_world: 4x4 inverse of that pose.
        T_world_cameras: (N, 4, 4) all poses.
        times_s: (N,) their stamps after that of the pose, s.
        at: Index of the pose.
    """
    velocity = np.zeros(6)
    for i in range(len(times_s)):
        if i == at:
            continue
        weight = 1.0 / times_s[i]
        for j in range(len(times_s)):
            if j not in (i, at):
                weight *= -times_s[j] / (times_s[i] - times_s[j])
        velocity += weight * se3_log(compose(T_camera_world, T_world_cameras[i]))
    return velocity
