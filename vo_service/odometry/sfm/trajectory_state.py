"""State along a chain of good frames: poses, covariance, keyframes, and the scale's sigma."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.motion_model import MAX_SPEED_M_S
from vo_service.odometry.sfm.keyframe import RegisteredView, SfmKeyframe
from vo_service.odometry.sfm.keyframe_window import KeyframeWindow, make_keyframe_candidate
from vo_service.odometry.sfm.mono_frame import MonoFrame, ShutterMotion
from vo_service.odometry.sfm.parameters import SfmParameters

# Parameters in pixels are for this focal length: a Kinect's image, 640 pixels wide.
REFERENCE_FOCAL_PX = 525.0
# Margin for the error of a step's length.
STEP_MARGIN_M = 0.03


@dataclass(frozen=True)
class TrajectoryStep:
    """Motion since the last good frame.

    Attributes:
        T_last_camera: 4x4.
        covariance: 6x6, as that of an `Estimate`.
    """

    T_last_camera: Array
    covariance: Array


class TrajectoryState:
    """State of a chain of registered frames, in one world frame and one scale."""

    def __init__(self, parameters: SfmParameters) -> None:
        self._parameters = parameters
        self._window = KeyframeWindow(parameters)
        self.T_world_last = np.eye(4)
        self._last_registered: RegisteredView | None = None  # since the newest keyframe
        self._covariance = np.zeros((6, 6))  # of the last good frame against its keyframe
        self._first_inliers = 0  # of the first frame after the newest keyframe
        self._scale_sigma = 0.0
        self._shutter_motion, self._stamp_s = ShutterMotion(), 0.0  # at the last good frame
        self.has_scale = False

    def reset(self, view: MonoFrame) -> None:
        """Start a new chain with a view at the last good pose, without points and scale."""
        self._window.reset(view, self.T_world_last)
        self._last_registered, self._covariance = None, np.zeros((6, 6))
        self._shutter_motion, self._stamp_s = ShutterMotion(), view.stamp_s
        self.has_scale = False

    @property
    def window(self) -> KeyframeWindow:
        """The keyframes and their points."""
        return self._window

    def initial_guess(self, keyframe: SfmKeyframe) -> Array:
        """4x4 T_camera_keyframe at rest since the last good frame."""
        return inverse(self.T_world_last) @ keyframe.T_world_camera

    def predict_view(self, view: MonoFrame) -> MonoFrame:
        """Compensate a view's rolling shutter by the velocity at the last good frame."""
        return view.compensate_rolling_shutter(self._shutter_motion)

    def estimate_shutter_motion(self, registered: RegisteredView) -> ShutterMotion:
        """Velocity from the last good frame to a view."""
        T_last_camera = inverse(self.T_world_last) @ registered.T_world_camera
        duration_s = registered.matched_view.view.stamp_s - self._stamp_s
        return ShutterMotion.from_motion(T_last_camera, duration_s, registered.median_inverse_depth)

    def is_too_fast(self, registered: RegisteredView) -> bool:
        """Whether a view is too far from the last good frame for any camera."""
        distance_m = float(
            np.linalg.norm((inverse(self.T_world_last) @ registered.T_world_camera)[:3, 3])
        )
        duration_s = abs(registered.matched_view.view.stamp_s - self._stamp_s)
        return distance_m > MAX_SPEED_M_S * duration_s + STEP_MARGIN_M

    def initialize(self, registered: RegisteredView, sigma: float) -> TrajectoryStep:
        """Add the first view in meters, with the sigma of the scale's logarithm."""
        self._window.reset(registered.matched_view.keyframe.view, self.T_world_last)
        self.has_scale = True
        self._scale_sigma = sigma
        return self._add(registered, is_keyframe=True)

    def add(self, registered: RegisteredView) -> TrajectoryStep:
        """Add the next view."""
        if self._last_registered is None:
            self._first_inliers = registered.num_inliers
        return self._add(registered, self._needs_keyframe(registered))

    def promote_last_frame(self) -> bool:
        """Make the last good frame a keyframe, as later frames may match it better.

        Returns False if it is one already.
        """
        if self._last_registered is None:
            return False
        self._add_keyframe(self._last_registered)
        return True

    def _add(self, registered: RegisteredView, is_keyframe: bool) -> TrajectoryStep:
        T_world_before = self.T_world_last
        self._shutter_motion, self._stamp_s = (
            self.estimate_shutter_motion(registered),
            registered.matched_view.view.stamp_s,
        )
        self.T_world_last, self._last_registered = registered.T_world_camera, registered
        if is_keyframe:
            self._add_keyframe(registered)
            self.T_world_last = self._window.keyframes[0].T_world_camera
        T_last_camera = inverse(T_world_before) @ self.T_world_last
        # The scale's error is along the step.
        translation = inverse(T_last_camera)[:3, 3]
        covariance = transport_covariance(self._covariance, T_last_camera) + registered.covariance
        covariance[:3, :3] += self._scale_sigma**2 * np.outer(translation, translation)
        self._covariance = registered.covariance
        return TrajectoryStep(T_last_camera, covariance)

    def _add_keyframe(self, registered: RegisteredView) -> None:
        candidate = make_keyframe_candidate(
            registered.matched_view.view,
            registered.T_world_camera,
            registered.matched_view.matches,
            registered.two_view,
        )
        added_sigma = self._window.add(candidate, registered.matched_view.keyframe)
        self._scale_sigma = float(np.hypot(self._scale_sigma, added_sigma))
        self._last_registered = None

    def _needs_keyframe(self, registered: RegisteredView) -> bool:
        """Whether the view has too little overlap with its keyframe."""
        parameters = self._parameters
        is_initial = self._window.is_initial
        flow_px = parameters.max_initial_flow_px if is_initial else parameters.max_keyframe_flow_px
        share = registered.num_inliers / max(self._first_inliers, 1)
        return (
            share < parameters.min_keyframe_inlier_share
            or registered.median_flow * REFERENCE_FOCAL_PX > flow_px
        )
