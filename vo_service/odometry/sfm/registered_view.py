"""A view beside a keyframe; and placed by it, or not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, orthonormalize
from vo_service.odometry.sfm.essential import UnscaledMotion
from vo_service.odometry.sfm.keyframe import Indices, SfmKeyframe
from vo_service.odometry.sfm.mono_frame import MonoFrame, RayPairs
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate
from vo_service.types import TrackingDebug

# Points share the errors of the views that they were found by, so that together they are less
# sure than so many points of their own; measured, as is how far a whole image is off in any case.
COVARIANCE_INFLATION = 1.2
MIN_SIGMA_PX = 0.1


@dataclass(frozen=True)
class MatchedView:
    """A view beside a keyframe.

    matches    (M, 2) features of the view and of the keyframe that look the same
    pairs      their rays, and the depths that are known
    direction  what the rays say of the motion; None: nothing
    """

    view: MonoFrame
    keyframe: SfmKeyframe
    matches: Indices
    pairs: RayPairs
    unscaled_motion: UnscaledMotion | None

    def make_tracking_debug(self, inlier: NDArray[np.bool_]) -> TrackingDebug:
        """What a viewer can draw; `inlier` (M,) are the matches that agree."""
        return TrackingDebug(
            keypoints_px=self.view.features.position_px,
            matches_px=self.view.features.position_px[self.matches[:, 0]],
            reference_matches_px=self.keyframe.view.features.position_px[self.matches[:, 1]],
            inlier=inlier,
        )


@dataclass(frozen=True)
class RegisteredView:
    """The motion, in metres, between the view and the keyframe of a sight."""

    matched_view: MatchedView
    two_view: TwoViewEstimate

    @property
    def T_world_camera(self) -> Array:
        """4x4, by where the keyframe is."""
        T_keyframe_camera = inverse(self.two_view.T_camera_reference)
        return orthonormalize(self.matched_view.keyframe.T_world_camera @ T_keyframe_camera)

    @property
    def num_known_inliers(self) -> int:
        """How many of the matches that agree have a depth that was known before."""
        return int((self.two_view.inlier & self.matched_view.pairs.has_known_depth).sum())

    @property
    def num_inliers(self) -> int:
        """How many matches agree."""
        return int(self.two_view.inlier.sum())

    @property
    def median_inverse_depth(self) -> float:
        """Of what is seen, 1/m: the median over the matches that agree."""
        return float(np.median(self.two_view.inverse_depth[self.two_view.inlier]))

    @property
    def covariance(self) -> Array:
        """6x6 of the motion, as that of an `Estimate`; larger where fewer of the matches agree."""
        less_sure = COVARIANCE_INFLATION * len(self.matched_view.matches) / self.num_inliers
        shift_rad = MIN_SIGMA_PX / self.matched_view.view.focal_px
        floor = shift_rad * np.array([1.0 / self.median_inverse_depth] * 3 + [1.0] * 3)
        covariance: Array = less_sure**2 * self.two_view.covariance + np.diag(floor**2)
        return covariance

    @property
    def max_sigma_rad(self) -> float:
        """How far off the motion may leave what is seen: the largest standard deviation."""
        to_angle = np.array([self.median_inverse_depth] * 3 + [1.0] * 3)
        return float(
            np.sqrt(np.linalg.eigvalsh(self.covariance * np.outer(to_angle, to_angle))[-1])
        )

    @property
    def median_flow(self) -> float:
        """How far the features moved in the image: the median, at z = 1."""
        ok, pairs = self.two_view.inlier, self.matched_view.pairs
        return float(np.median(np.linalg.norm(pairs.ray[ok] - pairs.ray_reference[ok], axis=1)))


@dataclass(frozen=True)
class RegistrationFailure:
    """Why a view could not be placed.

    reason   one short clause for people
    waiting  True if nothing is wrong but that the camera has not moved far enough yet
    """

    matched_view: MatchedView
    reason: str
    is_waiting: bool = False
