"""The chain of good frames: poses, covariance, keyframes, and how sure the scale still is."""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, carried, inverse
from vo_service.odometry.motion_model import FASTEST_M_S
from vo_service.odometry.sfm.colour_view import ColourView
from vo_service.odometry.sfm.keyframe import Keyframe
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.placed import Placed
from vo_service.odometry.sfm.sweep import Sweep
from vo_service.odometry.sfm.window import Window, step_of

# Settings in pixels are for an image whose focal length is this: 640 pixels wide, of a Kinect.
FOCAL_PX = 525.0
# A step may be measured this much too long.
UNSTEADY_M = 0.03


@dataclass(frozen=True)
class Link:
    """One more good frame.

    T_last_camera  4x4 motion since the last one
    covariance     6x6 of it, as that of an `Estimate`
    """

    T_last_camera: Array
    covariance: Array


class Chain:
    """Frames placed one after another, in one world and one scale."""

    def __init__(self, parameters: SfmParameters) -> None:
        self._parameters = parameters
        self._window = Window(parameters)
        self.T_world_last = np.eye(4)
        self._last: Placed | None = None  # since the newest keyframe
        self._covariance = np.zeros((6, 6))  # of the last good frame, as its keyframe saw it
        self._first_inliers = 0  # of the first frame after the newest keyframe
        self._scale_sigma = 0.0
        self._sweep, self._stamp_s = Sweep(), 0.0  # at the last good frame
        self.has_scale = False

    def begin(self, view: ColourView) -> None:
        """Begin anew with a view where the last good one was: no points, and no scale."""
        self._window.begin(view, self.T_world_last)
        self._last, self._covariance = None, np.zeros((6, 6))
        self._sweep, self._stamp_s = Sweep(), view.stamp_s
        self.has_scale = False

    @property
    def window(self) -> Window:
        """The keyframes and their points."""
        return self._window

    def guess(self, keyframe: Keyframe) -> Array:
        """4x4 T_camera_keyframe of a camera that has not moved since the last good frame."""
        return inverse(self.T_world_last) @ keyframe.T_world_camera

    def expected(self, view: ColourView) -> ColourView:
        """The view, of a camera that goes on as it did at the last good frame."""
        return view.sweeping(self._sweep)

    def sweep_to(self, placed: Placed) -> Sweep:
        """How the camera moved from the last good frame to a view."""
        T_last_camera = inverse(self.T_world_last) @ placed.T_world_camera
        duration_s = placed.sight.view.stamp_s - self._stamp_s
        return Sweep.over(T_last_camera, duration_s, placed.inverse_depth)

    def is_too_far(self, placed: Placed) -> bool:
        """Whether no camera can have come to a view since the last good frame."""
        way_m = float(np.linalg.norm((inverse(self.T_world_last) @ placed.T_world_camera)[:3, 3]))
        duration_s = abs(placed.sight.view.stamp_s - self._stamp_s)
        return way_m > FASTEST_M_S * duration_s + UNSTEADY_M

    def set_scale(self, first: Placed, sigma: float) -> Link:
        """The first view that was placed in metres; sigma of the scale's logarithm."""
        self._window.begin(first.sight.keyframe.view, self.T_world_last)
        self.has_scale = True
        self._scale_sigma = sigma
        return self._add(first, is_keyframe=True)

    def add(self, placed: Placed) -> Link:
        """The next view."""
        if self._last is None:
            self._first_inliers = placed.inliers
        return self._add(placed, self._is_due(placed))

    def make_last_a_keyframe(self) -> bool:
        """Let the last good frame be one, which the next ones may have more in common with.

        False if it is one already.
        """
        if self._last is None:
            return False
        self._keep(self._last)
        return True

    def _add(self, placed: Placed, is_keyframe: bool) -> Link:
        T_world_before = self.T_world_last
        self._sweep, self._stamp_s = self.sweep_to(placed), placed.sight.view.stamp_s
        self.T_world_last, self._last = placed.T_world_camera, placed
        if is_keyframe:
            self._keep(placed)
            self.T_world_last = self._window.keyframes[0].T_world_camera
        T_last_camera = inverse(T_world_before) @ self.T_world_last
        # The step is as long as the scale says it is.
        along = inverse(T_last_camera)[:3, 3]
        covariance = carried(self._covariance, T_last_camera) + placed.covariance
        covariance[:3, :3] += self._scale_sigma**2 * np.outer(along, along)
        self._covariance = placed.covariance
        return Link(T_last_camera, covariance)

    def _keep(self, placed: Placed) -> None:
        step = step_of(
            placed.sight.view, placed.T_world_camera, placed.sight.matches, placed.refined
        )
        added = self._window.add(step, placed.sight.keyframe)
        self._scale_sigma = float(np.hypot(self._scale_sigma, added))
        self._last = None

    def _is_due(self, placed: Placed) -> bool:
        """Whether it has too little in common with the keyframe for the next one to be sure."""
        parameters = self._parameters
        young = self._window.is_young
        flow_px = parameters.young_flow_px if young else parameters.keyframe_flow_px
        share = placed.inliers / max(self._first_inliers, 1)
        return share < parameters.keyframe_share or placed.flow * FOCAL_PX > flow_px
