"""The chain of good frames: poses, covariance, keyframes, and how sure the scale still is."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.motion_model import MAX_SPEED_M_S
from vo_service.odometry.sfm.keyframe import SfmKeyframe
from vo_service.odometry.sfm.keyframe_window import KeyframeWindow, make_keyframe_candidate
from vo_service.odometry.sfm.mono_frame import MonoFrame
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.registered_view import RegisteredView
from vo_service.odometry.sfm.rolling_shutter import ShutterMotion

# Settings in pixels are for an image whose focal length is this: 640 pixels wide, of a Kinect.
REFERENCE_FOCAL_PX = 525.0
# A step may be measured this much too long.
STEP_MARGIN_M = 0.03


@dataclass(frozen=True)
class TrajectoryStep:
    """One more good frame.

    T_last_camera  4x4 motion since the last one
    covariance     6x6 of it, as that of an `Estimate`
    """

    T_last_camera: Array
    covariance: Array


class TrajectoryState:
    """Frames placed one after another, in one world and one scale."""

    def __init__(self, parameters: SfmParameters) -> None:
        self._parameters = parameters
        self._window = KeyframeWindow(parameters)
        self.T_world_last = np.eye(4)
        self._last_registered: RegisteredView | None = None  # since the newest keyframe
        self._covariance = np.zeros((6, 6))  # of the last good frame, as its keyframe saw it
        self._first_inliers = 0  # of the first frame after the newest keyframe
        self._scale_sigma = 0.0
        self._shutter_motion, self._stamp_s = ShutterMotion(), 0.0  # at the last good frame
        self.has_scale = False

    def reset(self, view: MonoFrame) -> None:
        """Begin anew with a view where the last good one was: no points, and no scale."""
        self._window.reset(view, self.T_world_last)
        self._last_registered, self._covariance = None, np.zeros((6, 6))
        self._shutter_motion, self._stamp_s = ShutterMotion(), view.stamp_s
        self.has_scale = False

    @property
    def window(self) -> KeyframeWindow:
        """The keyframes and their points."""
        return self._window

    def initial_guess(self, keyframe: SfmKeyframe) -> Array:
        """4x4 T_camera_keyframe of a camera that has not moved since the last good frame."""
        return inverse(self.T_world_last) @ keyframe.T_world_camera

    def predict_view(self, view: MonoFrame) -> MonoFrame:
        """The view, of a camera that goes on as it did at the last good frame."""
        return view.compensate_rolling_shutter(self._shutter_motion)

    def estimate_shutter_motion(self, registered: RegisteredView) -> ShutterMotion:
        """How the camera moved from the last good frame to a view."""
        T_last_camera = inverse(self.T_world_last) @ registered.T_world_camera
        duration_s = registered.matched_view.view.stamp_s - self._stamp_s
        return ShutterMotion.from_motion(T_last_camera, duration_s, registered.median_inverse_depth)

    def is_too_fast(self, registered: RegisteredView) -> bool:
        """Whether no camera can have come to a view since the last good frame."""
        way_m = float(
            np.linalg.norm((inverse(self.T_world_last) @ registered.T_world_camera)[:3, 3])
        )
        duration_s = abs(registered.matched_view.view.stamp_s - self._stamp_s)
        return way_m > MAX_SPEED_M_S * duration_s + STEP_MARGIN_M

    def initialize(self, registered: RegisteredView, sigma: float) -> TrajectoryStep:
        """The first view that was placed in metres; sigma of the scale's logarithm."""
        self._window.reset(registered.matched_view.keyframe.view, self.T_world_last)
        self.has_scale = True
        self._scale_sigma = sigma
        return self._add(registered, is_keyframe=True)

    def add(self, registered: RegisteredView) -> TrajectoryStep:
        """The next view."""
        if self._last_registered is None:
            self._first_inliers = registered.num_inliers
        return self._add(registered, self._needs_keyframe(registered))

    def promote_last_frame(self) -> bool:
        """Let the last good frame be one, which the next ones may have more in common with.

        False if it is one already.
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
        # The step is as long as the scale says it is.
        along = inverse(T_last_camera)[:3, 3]
        covariance = transport_covariance(self._covariance, T_last_camera) + registered.covariance
        covariance[:3, :3] += self._scale_sigma**2 * np.outer(along, along)
        self._covariance = registered.covariance
        return TrajectoryStep(T_last_camera, covariance)

    def _add_keyframe(self, registered: RegisteredView) -> None:
        step = make_keyframe_candidate(
            registered.matched_view.view,
            registered.T_world_camera,
            registered.matched_view.matches,
            registered.two_view,
        )
        added = self._window.add(step, registered.matched_view.keyframe)
        self._scale_sigma = float(np.hypot(self._scale_sigma, added))
        self._last_registered = None

    def _needs_keyframe(self, registered: RegisteredView) -> bool:
        """Whether it has too little in common with the keyframe for the next one to be sure."""
        parameters = self._parameters
        young = self._window.is_initial
        flow_px = parameters.max_initial_flow_px if young else parameters.max_keyframe_flow_px
        share = registered.num_inliers / max(self._first_inliers, 1)
        return (
            share < parameters.min_keyframe_inlier_share
            or registered.median_flow * REFERENCE_FOCAL_PX > flow_px
        )
