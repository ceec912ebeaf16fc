"""Views and their normal equations of the sensor's timing: readout time and delay of depth.

A wrong timing leaves residuals that grow with the velocity and with a row's distance from the
middle one. Two more columns of the normal equations measure it; pose, brightness and a turn of the
depth camera are marginalized, as they are estimated with it. The velocity at a view follows from
the poses around it. Rolling shutter as in Kerl, Stueckler and Cremers, "Dense Continuous-Time
Tracking and Mapping with Rolling Shutter RGB-D Cameras" (ICCV 2015); online estimate of a delay as
in Qin and Shen, "Online Temporal Calibration for Monocular Visual-Inertial Systems" (IROS 2018).
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.factor import (
    Jacobian,
    jacobian,
    student_curvature,
    student_weight,
)
from vo_service.odometry.direct.gauss_newton import add_residual
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import (
    body_motion,
    compose,
    constant_velocity_motion,
    invert,
    se3_adjoint,
    se3_log,
)
from vo_service.odometry.direct.parameters import (
    MAX_POSE_INTERVAL_S,
    MIN_FRAME_INTERVAL_S,
    TIMING_POINT_STRIDE,
    TIMING_STEP_RATIO,
    TURN_INFORMATION,
)
from vo_service.odometry.direct.points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_V,
)
from vo_service.odometry.direct.residuals import (
    GAIN,
    WEIGHT_BRIGHTNESS,
    residual_variances,
)

# Pose (6), gain, turn of the depth camera (2), readout, delay.
NUM_UNKNOWNS = 11
FIRST_TURN, FIRST_TIMING, NUM_TIMING = 7, 9, 2


# Columns of the twists of a view, see `TimingView`.
VELOCITY, VELOCITY_CHANGE, KEYFRAME_VELOCITY, KEYFRAME_VELOCITY_CHANGE = range(4)
TURNS, KEYFRAME_TURNS, NUM_TWISTS = 4, 6, 8


class TimingView(NamedTuple):
    """What the timing kernel needs of a view, beside its points and samples.

    Attributes:
        twists: (6, TWISTS) of the keyframe's points in the keyframe's axes, m/s and rad/s: while
            the frame was taken; the same minus what the alignment took it for; while the keyframe
            was taken; the same minus what the keyframe's points were made with; of a camera that
            turns about its own x and y axis at 1 rad/s, at the frame (2) and at the keyframe (2).
        camera_position: (3,) of the frame's camera in the keyframe's axes, m.
        timing: (2,) readout and delay that the frame was aligned with.
        keyframe_timing: (2,) those of the keyframe.
        intrinsics: (4,) of the whole image.
        height: Rows of the whole image.
    """

    twists: Array
    camera_position: Array
    timing: Array
    keyframe_timing: Array
    intrinsics: Array
    height: int


@kernel
def make_twists(
    T_camera_keyframe: Array, of_frame: tuple[Array, Array], of_keyframe: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Twists (6, TWISTS) and camera position (3,) of a view, see `TimingView`.

    Args:
        T_camera_keyframe: 4x4.
        of_frame: Motion (9,) of the keyframe's points that the frame was aligned with, and the
            velocity (6,) of the frame's camera in its own axes.
        of_keyframe: Motion (9,) of the camera that the keyframe was made with, and its velocity
            (6,), both in its own axes.
    """
    (aligned, velocity), (made, keyframe_velocity) = of_frame, of_keyframe
    T_keyframe_camera = invert(T_camera_keyframe)
    Ad, twists = se3_adjoint(T_keyframe_camera), np.zeros((6, NUM_TWISTS))
    in_keyframe = body_motion(T_keyframe_camera, constant_velocity_motion(velocity))
    for k in range(6):
        twists[k, VELOCITY] = in_keyframe[k]
        twists[k, VELOCITY_CHANGE] = in_keyframe[k] - aligned[k]
        twists[k, KEYFRAME_VELOCITY] = -keyframe_velocity[k]
        twists[k, KEYFRAME_VELOCITY_CHANGE] = made[k] - keyframe_velocity[k]
        for turn in range(2):
            twists[k, TURNS + turn] = -Ad[k, 3 + turn]
    for turn in range(2):
        twists[3 + turn, KEYFRAME_TURNS + turn] = -1.0
    return twists, T_keyframe_camera[:3, 3].copy()


@kernel
def accumulate_timing(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array, view: TimingView
) -> tuple[Array, Array]:
    """Normal equations of pose, brightness, turn, readout and delay of one view.

    Args:
        points: (N, COLUMNS) of the keyframe's finest level.
        samples: (N, COLUMNS) of the view.
        cell_weights: (2, CELLS).
        residual_model: (6,), see `residuals`.
        view: The view's velocities and timing.

    Returns:
        (11, 11), of which the upper triangle is used, and (11,).
    """
    H, g = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), np.zeros(NUM_UNKNOWNS)
    row, gain = np.zeros(NUM_UNKNOWNS), residual_model[GAIN]
    variance, variance_depth = residual_variances(residual_model)
    # Fields of a tuple cost time in a loop.
    twists, camera_position, timing, keyframe_timing, intrinsics, height = view
    timings = timing[0], timing[1], keyframe_timing[0], keyframe_timing[1]
    middle_row = 0.5 * (height - 1)
    for i in range(0, len(points), TIMING_POINT_STRIDE):
        brightness, depth = samples[i, SAMPLE_BRIGHTNESS], samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        cell = int(samples[i, SAMPLE_CELL])
        v_keyframe = intrinsics[1] * points[i, 1] / points[i, 2] + intrinsics[3]
        # Times of the rows as shares of the readout.
        shares = (samples[i, SAMPLE_V] - middle_row) / height, (v_keyframe - middle_row) / height
        J_depth = jacobian(points[i], POINT_DEPTH_GRADIENT, 1.0)
        if points[i, HAS_TEXTURE] > 0:
            residual = brightness - gain * points[i, POINT_BRIGHTNESS]
            sample_variance = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            w = student_weight(residual, sample_variance)
            w *= residual_model[WEIGHT_BRIGHTNESS] * cell_weights[0, cell]
            curvature = w * student_curvature(residual, sample_variance)
            J = jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, gain)
            # Only parallax shows an error of the point's depth in its brightness.
            by_depth = -points[i, 2] * (
                J[0] * camera_position[0] + J[1] * camera_position[1] + J[2] * camera_position[2]
            )
            row[6] = -points[i, POINT_BRIGHTNESS]
            linear = _fill_brightness_row(J, J_depth, by_depth, twists, shares, timings, row)
            add_residual(H, g, row, curvature, w * residual + curvature * linear)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = student_weight(depth, variance_depth) * cell_weights[1, cell]
            curvature = w * student_curvature(depth, variance_depth)
            row[6] = 0.0
            linear = _fill_depth_row(J_depth, twists, shares, timings, row)
            add_residual(H, g, row, curvature, w * depth + curvature * linear)
    for k in range(FIRST_TURN, FIRST_TIMING):
        H[k, k] += TURN_INFORMATION
    return H, g


@inline_kernel
def _change(J: Jacobian, twists: Array, n: int) -> float:
    """Change of a residual with derivative J by one of the twists (6, TWISTS)."""
    return float(
        J[0] * twists[0, n]
        + J[1] * twists[1, n]
        + J[2] * twists[2, n]
        + J[3] * twists[3, n]
        + J[4] * twists[4, n]
        + J[5] * twists[5, n]
    )


@inline_kernel
def _fill_brightness_row(
    J: Jacobian,
    J_depth: Jacobian,
    by_depth: float,
    twists: Array,
    shares: tuple[float, float],
    timings: tuple[float, float, float, float],
    row: Array,
) -> float:
    """Fill in the derivatives of a brightness residual by pose, turn and timing.

    Args:
        J: Derivative of the residual.
        J_depth: Derivative of the depth residual.
        by_depth: Derivative of the residual by the depth residual.
        twists: (6, TWISTS), see `TimingView`.
        shares: Times of the frame's and of the keyframe's row as shares of the readout.
        timings: Readout and delay of the frame, then of the keyframe.
        row: (UNKNOWNS,) the derivatives.

    Returns:
        What is added to the residual to make it that of zero timing and of the view's velocities.
    """
    (share, keyframe_share), (readout, _, keyframe_readout, keyframe_delay) = shares, timings
    by_frame = share * _change(J, twists, VELOCITY)
    by_keyframe = -keyframe_share * _change(J, twists, KEYFRAME_VELOCITY)
    by_delay = by_depth * _change(J_depth, twists, KEYFRAME_VELOCITY)
    for k in range(6):
        row[k] = J[k]
    for k in range(2):
        row[FIRST_TURN + k] = by_depth * _change(J_depth, twists, KEYFRAME_TURNS + k)
    row[FIRST_TIMING], row[FIRST_TIMING + 1] = by_frame + by_keyframe, by_delay
    used = by_frame * readout + by_keyframe * keyframe_readout + by_delay * keyframe_delay
    return float(
        readout * share * _change(J, twists, VELOCITY_CHANGE)
        - keyframe_readout * keyframe_share * _change(J, twists, KEYFRAME_VELOCITY_CHANGE)
        + keyframe_delay * by_depth * _change(J_depth, twists, KEYFRAME_VELOCITY_CHANGE)
        - TIMING_STEP_RATIO * used
    )


@inline_kernel
def _fill_depth_row(
    J: Jacobian,
    twists: Array,
    shares: tuple[float, float],
    timings: tuple[float, float, float, float],
    row: Array,
) -> float:
    """Fill in the derivatives of a depth residual; see `_fill_brightness_row`."""
    velocity, keyframe_velocity = (
        _change(J, twists, VELOCITY),
        _change(J, twists, KEYFRAME_VELOCITY),
    )
    for k in range(6):
        row[k] = J[k]
    for k in range(2):
        turn = _change(J, twists, TURNS + k) - _change(J, twists, KEYFRAME_TURNS + k)
        row[FIRST_TURN + k] = turn
    row[FIRST_TIMING] = shares[0] * velocity - shares[1] * keyframe_velocity
    row[FIRST_TIMING + 1] = velocity - keyframe_velocity
    frame_s = shares[0] * timings[0] + timings[1]
    keyframe_s = shares[1] * timings[2] + timings[3]
    return float(
        frame_s * _change(J, twists, VELOCITY_CHANGE)
        - keyframe_s * _change(J, twists, KEYFRAME_VELOCITY_CHANGE)
        - TIMING_STEP_RATIO * (frame_s * velocity - keyframe_s * keyframe_velocity)
    )


# Poses of a velocity: two before the frame, two after it.
NUM_VELOCITY_POSES = 5
# Of the first frame, which has none before it.
NUM_FIRST_VELOCITY_POSES = 4
# Unused views are forgotten when there are more of them: at every frame it would cost more.
MAX_UNUSED_VIEWS = 30


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
        """Make the view of a frame that was aligned with nothing.

        Args:
            timed: The frame.
            T_world_camera: 4x4 pose.
            timing: (2,) correction of its timing, s.
        """
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
