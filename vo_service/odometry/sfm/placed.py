"""A view beside a keyframe; and placed by it, or not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, inverse, orthonormal
from vo_service.odometry.sfm.colour_view import ColourView, RayPairs
from vo_service.odometry.sfm.essential import Direction
from vo_service.odometry.sfm.keyframe import Indices, Keyframe
from vo_service.odometry.sfm.refinement import Refined
from vo_service.types import Evidence

# Points share the errors of the views that they were found by, so that together they are less
# sure than so many points of their own; measured, as is how far a whole image is off in any case.
SHARED = 1.2
SHIFT_PX = 0.1


@dataclass(frozen=True)
class Sight:
    """A view beside a keyframe.

    matches    (M, 2) features of the view and of the keyframe that look the same
    pairs      their rays, and the depths that are known
    direction  what the rays say of the motion; None: nothing
    """

    view: ColourView
    keyframe: Keyframe
    matches: Indices
    pairs: RayPairs
    direction: Direction | None

    def evidence(self, inlier: NDArray[np.bool_]) -> Evidence:
        """What a viewer can draw; `inlier` (M,) are the matches that agree."""
        return Evidence(
            keypoints_px=self.view.features.position_px,
            matches_px=self.view.features.position_px[self.matches[:, 0]],
            reference_matches_px=self.keyframe.view.features.position_px[self.matches[:, 1]],
            inlier=inlier,
        )


@dataclass(frozen=True)
class Placed:
    """The motion, in metres, between the view and the keyframe of a sight."""

    sight: Sight
    refined: Refined

    @property
    def T_world_camera(self) -> Array:
        """4x4, by where the keyframe is."""
        T_keyframe_camera = inverse(self.refined.T_camera_reference)
        return orthonormal(self.sight.keyframe.T_world_camera @ T_keyframe_camera)

    @property
    def known_inliers(self) -> int:
        """How many of the matches that agree have a depth that was known before."""
        return int((self.refined.inlier & self.sight.pairs.known).sum())

    @property
    def inliers(self) -> int:
        """How many matches agree."""
        return int(self.refined.inlier.sum())

    @property
    def inverse_depth(self) -> float:
        """Of what is seen, 1/m: the median over the matches that agree."""
        return float(np.median(self.refined.inverse_depth[self.refined.inlier]))

    @property
    def covariance(self) -> Array:
        """6x6 of the motion, as that of an `Estimate`; larger where fewer of the matches agree."""
        less_sure = SHARED * len(self.sight.matches) / self.inliers
        shift_rad = SHIFT_PX / self.sight.view.focal_px
        floor = shift_rad * np.array([1.0 / self.inverse_depth] * 3 + [1.0] * 3)
        covariance: Array = less_sure**2 * self.refined.covariance + np.diag(floor**2)
        return covariance

    @property
    def doubt_rad(self) -> float:
        """How far off the motion may leave what is seen: the largest standard deviation."""
        to_angle = np.array([self.inverse_depth] * 3 + [1.0] * 3)
        return float(
            np.sqrt(np.linalg.eigvalsh(self.covariance * np.outer(to_angle, to_angle))[-1])
        )

    @property
    def flow(self) -> float:
        """How far the features moved in the image: the median, at z = 1."""
        ok, pairs = self.refined.inlier, self.sight.pairs
        return float(np.median(np.linalg.norm(pairs.ray[ok] - pairs.ray_reference[ok], axis=1)))


@dataclass(frozen=True)
class NotPlaced:
    """Why a view could not be placed.

    reason   one short clause for people
    waiting  True if nothing is wrong but that the camera has not moved far enough yet
    """

    sight: Sight
    reason: str
    waiting: bool = False
