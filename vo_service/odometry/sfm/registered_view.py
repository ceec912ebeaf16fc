"""A view matched with a keyframe, and its registration or failure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, orthonormalize
from vo_service.odometry.sfm.essential import UnscaledMotion
from vo_service.odometry.sfm.keyframe import Indices, SfmKeyframe
from vo_service.odometry.sfm.mono_frame import MonoFrame, RayPairs
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate
from vo_service.types import TrackingDebug

# Factor for the errors of the views that all points share, and lower bound of an image's error.
# Both are measured.
COVARIANCE_INFLATION = 1.2
MIN_SIGMA_PX = 0.1


@dataclass(frozen=True)
class MatchedView:
    """A view matched with a keyframe.

    Attributes:
        view: The view.
        keyframe: The keyframe.
        matches: (M, 2) matched features of the view and of the keyframe.
        pairs: Their rays and known depths.
        unscaled_motion: The motion by the rays; None if there is none.
    """

    view: MonoFrame
    keyframe: SfmKeyframe
    matches: Indices
    pairs: RayPairs
    unscaled_motion: UnscaledMotion | None

    def make_tracking_debug(self, inlier: NDArray[np.bool_]) -> TrackingDebug:
        """Make the debug data; `inlier` (M,) are the matches that agree."""
        return TrackingDebug(
            keypoints_px=self.view.features.position_px,
            matches_px=self.view.features.position_px[self.matches[:, 0]],
            reference_matches_px=self.keyframe.view.features.position_px[self.matches[:, 1]],
            inlier=inlier,
        )


@dataclass(frozen=True)
class RegisteredView:
    """A matched view and its motion in meters since the keyframe."""

    matched_view: MatchedView
    two_view: TwoViewEstimate

    @property
    def T_world_camera(self) -> Array:
        """4x4 pose, by that of the keyframe."""
        T_keyframe_camera = inverse(self.two_view.T_camera_reference)
        return orthonormalize(self.matched_view.keyframe.T_world_camera @ T_keyframe_camera)

    @property
    def num_known_inliers(self) -> int:
        """Number of matches that agree and have a known depth."""
        return int((self.two_view.inlier & self.matched_view.pairs.has_known_depth).sum())

    @property
    def num_inliers(self) -> int:
        """Number of matches that agree."""
        return int(self.two_view.inlier.sum())

    @property
    def median_inverse_depth(self) -> float:
        """Median inverse depth of the matches that agree, 1/m."""
        return float(np.median(self.two_view.inverse_depth[self.two_view.inlier]))

    @property
    def covariance(self) -> Array:
        """6x6 of the motion, as that of an `Estimate`; larger if fewer matches agree."""
        inflation = COVARIANCE_INFLATION * len(self.matched_view.matches) / self.num_inliers
        shift_rad = MIN_SIGMA_PX / self.matched_view.view.focal_px
        floor = shift_rad * np.array([1.0 / self.median_inverse_depth] * 3 + [1.0] * 3)
        covariance: Array = inflation**2 * self.two_view.covariance + np.diag(floor**2)
        return covariance

    @property
    def max_sigma_rad(self) -> float:
        """Largest standard deviation of the motion, as an angle at the median depth."""
        to_angle = np.array([self.median_inverse_depth] * 3 + [1.0] * 3)
        return float(
            np.sqrt(np.linalg.eigvalsh(self.covariance * np.outer(to_angle, to_angle))[-1])
        )

    @property
    def median_flow(self) -> float:
        """Median displacement of the features in the image, at z = 1."""
        ok, pairs = self.two_view.inlier, self.matched_view.pairs
        return float(np.median(np.linalg.norm(pairs.ray[ok] - pairs.ray_reference[ok], axis=1)))


@dataclass(frozen=True)
class RegistrationFailure:
    """A view that could not be registered.

    Attributes:
        matched_view: The view.
        reason: Why, as one short clause.
        is_waiting: Whether the camera only has not moved far enough yet.
    """

    matched_view: MatchedView
    reason: str
    is_waiting: bool = False
