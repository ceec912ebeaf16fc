"""The last tracked views, and the velocity at each: that of a polynomial through poses around it.

The equations of the calibration need velocities that do not depend on the calibration themselves.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.calibration_equations import FOCAL, TIMING
from vo_service.odometry.direct.image_pyramid import ImageTiming
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import compose, invert, se3_log
from vo_service.odometry.direct.parameters import MAX_POSE_INTERVAL_S, MIN_FRAME_INTERVAL_S

# Poses of a velocity: two before the frame, two after it.
NUM_VELOCITY_POSES = 5
# Of the first frame, which has none before it.
NUM_FIRST_VELOCITY_POSES = 4
# Unused views are forgotten when there are more of them: at every frame it would cost more.
MAX_UNUSED_VIEWS = 30


@dataclass(frozen=True)
class ToldFrame:
    """A frame with the timing that it tells.

    Attributes:
        frame: The frame as it came from the camera.
        timing: (2,) its readout and the delay of depth after color, s.
    """

    frame: RgbdFrame
    timing: Array

    @classmethod
    def of(cls, frame: RgbdFrame) -> "ToldFrame":
        """Make it from a frame of a camera."""
        return cls(frame, np.array([frame.readout_s, frame.skew_s]))

    def with_correction(self, correction: Array) -> RgbdFrame:
        """Return the frame with a corrected calibration.

        Args:
            correction: (3,) of readout, delay and logarithm of the focal length.
        """
        shutter = corrected_shutter(self.timing, correction)
        return replace(
            self.frame,
            camera=correct_camera(self.frame.camera, correction),
            readout_s=shutter.readout_s,
            skew_s=shutter.skew_s,
        )


def correct_camera(camera: PinholeCamera, correction: Array) -> PinholeCamera:
    """Return a camera with the focal length corrected by a calibration (3,)."""
    if correction[FOCAL] == 0.0:
        return camera
    scale = exp(correction[FOCAL])
    return replace(camera, fx=scale * camera.fx, fy=scale * camera.fy)


def corrected_shutter(told: Array, correction: Array) -> ImageTiming:
    """Timing of images whose frame tells (2,) s, corrected; the readout is at least zero."""
    readout_s, skew_s = (told[TIMING] + correction[TIMING]).tolist()
    return ImageTiming(max(readout_s, 0.0), skew_s)


@dataclass
class TrackedView:
    """A tracked frame.

    Attributes:
        stamp_s: Of the frame.
        told: (2,) timing that the frame tells, s.
        calibration: (3,) correction that it was aligned with.
        T_world_camera: 4x4 pose.
        keyframe: The keyframe that it was aligned with; None if it was not aligned.
        alignment: The alignment.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s; None while unknown.
        is_first: Whether it is the first one of its world.
    """

    stamp_s: float
    told: Array
    calibration: Array
    T_world_camera: Array
    keyframe: DirectKeyframe | None = None
    alignment: DirectAlignment | None = None
    velocity: Array | None = None
    is_first: bool = False


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
        if self._recent:
            interval_s = view.stamp_s - self._recent[-1].stamp_s
            if not MIN_FRAME_INTERVAL_S <= interval_s <= MAX_POSE_INTERVAL_S:
                self._recent.clear()
        view.is_first, self._is_empty = self._is_empty, False
        self._recent.append(view)
        self._by_stamp[view.stamp_s] = view
        if len(self._by_stamp) > MAX_UNUSED_VIEWS + len(keyframes):
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
    T_world_cameras = np.array([view.T_world_camera for view in views])
    times_s = np.array([view.stamp_s for view in views]) - views[at].stamp_s
    return _fit_velocity(T_world_cameras, times_s, at)


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
