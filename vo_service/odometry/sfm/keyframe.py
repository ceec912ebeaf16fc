"""Keyframes, the 3-D points that their features observe, and views matched with a keyframe."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, orthonormalize, transform_points
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.sfm.essential import UnscaledMotion
from vo_service.odometry.sfm.mono_frame import PAIR_SIGMA_PX, MonoFrame, RayPairs
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate
from vo_service.types.estimate import TrackingDebug

Indices = NDArray[np.int64]

NO_POINT = -1
# Smallest depth of a point in front of a camera.
MIN_DEPTH_M = 0.05
# Gate between a feature and a point's projection, in standard deviations.
GATE_SIGMAS = 4.0


@dataclass(frozen=True)
class SfmKeyframe:
    """A view with its pose and observed points.

    Attributes:
        view: Features and rays.
        T_world_camera: 4x4.
        point_index: (N,) index of the point that each feature observes; -1 for none.
    """

    view: MonoFrame
    T_world_camera: Array
    point_index: Indices

    @classmethod
    def from_view(cls, view: MonoFrame, T_world_camera: Array) -> "SfmKeyframe":
        """Make a keyframe without observed points."""
        return cls(view, T_world_camera, np.full(len(view.features), NO_POINT, np.int64))

    def with_observations(self, features: Indices, points: Indices) -> "SfmKeyframe":
        """Return a copy in which these features observe these points."""
        point_index = self.point_index.copy()
        point_index[features] = points
        return replace(self, point_index=point_index)

    def without_observations(self, features: Indices | NDArray[np.bool_]) -> "SfmKeyframe":
        """Return a copy in which these features observe no point."""
        point_index = self.point_index.copy()
        point_index[features] = NO_POINT
        return replace(self, point_index=point_index)


@dataclass(frozen=True)
class SfmPoints:
    """3-D points.

    Attributes:
        position_m: (L, 3) in the world frame.
        covariance: (L, 3, 3) given the poses; zero if unknown.
    """

    position_m: Array
    covariance: Array

    @classmethod
    def empty(cls) -> "SfmPoints":
        """No points at all."""
        return cls(np.empty((0, 3)), np.empty((0, 3, 3)))

    def __len__(self) -> int:
        return len(self.position_m)

    def extended_by(self, position_m: Array) -> "SfmPoints":
        """Return a copy with more points (M, 3), whose covariance is unknown."""
        unknown = np.zeros((len(position_m), 3, 3))
        return SfmPoints(
            np.concatenate([self.position_m, position_m]),
            np.concatenate([self.covariance, unknown]),
        )


def pair_rays(
    view: MonoFrame, keyframe: SfmKeyframe, points: SfmPoints, matches: Indices
) -> RayPairs:
    """Pair the rays of matched features (M, 2) of a view and of a keyframe.

    A feature that observes a point gets the point's ray and depth, which all keyframes determine.

    Args:
        points: All points.
        matches: (M, 2) features of the view and of the keyframe.
    """
    T_camera_world = inverse(keyframe.T_world_camera)
    ray_reference = keyframe.view.ray[matches[:, 1]].copy()
    inverse_depth, information = np.zeros((2, len(matches)))
    observed = keyframe.point_index[matches[:, 1]]
    known = np.flatnonzero(observed != NO_POINT)
    P_camera = transform_points(T_camera_world, points.position_m[observed[known]])
    in_front = P_camera[:, 2] > MIN_DEPTH_M
    known, P_camera = known[in_front], P_camera[in_front]
    z = P_camera[:, 2]
    axis = T_camera_world[2, :3]
    variance_m2 = np.einsum("i,nij,j->n", axis, points.covariance[observed[known]], axis)
    ray_reference[known] = P_camera / z[:, None]
    inverse_depth[known] = 1.0 / z
    information[known] = z**4 / np.maximum(variance_m2, 1e-12)
    return RayPairs(
        view.ray[matches[:, 0]],
        ray_reference,
        inverse_depth,
        information,
        PAIR_SIGMA_PX / view.focal_px,
    )


def find_known_points(
    keyframe: SfmKeyframe, older: SfmKeyframe, points: SfmPoints, ratio: float
) -> SfmKeyframe:
    """Add observations of an older keyframe's points, where they match and project to the feature.

    The longer a point is observed, the less the scale and the pose drift.

    Args:
        older: A keyframe before it.
        points: All points.
        ratio: Of the matching, see `match_features`.
    """
    matches = match_features(keyframe.view.features, older.view.features, ratio)
    observed = older.point_index[matches[:, 1]]
    is_new = (observed != NO_POINT) & (keyframe.point_index[matches[:, 0]] == NO_POINT)
    is_new &= ~np.isin(observed, keyframe.point_index)
    matches, observed = matches[is_new], observed[is_new]
    P_camera = transform_points(inverse(keyframe.T_world_camera), points.position_m[observed])
    z = np.maximum(P_camera[:, 2], MIN_DEPTH_M)
    error = P_camera[:, :2] / z[:, None] - keyframe.view.ray[matches[:, 0], :2]
    gate = GATE_SIGMAS * PAIR_SIGMA_PX / keyframe.view.focal_px
    fits = (P_camera[:, 2] > MIN_DEPTH_M) & (np.einsum("ni,ni->n", error, error) < gate**2)
    return keyframe.with_observations(matches[fits, 0], observed[fits])


# Factor for the errors of the views that all points share, and lower bound of an image's error.
# Both are measured.
COVARIANCE_INFLATION = 1.2
MIN_SIGMA_PX = 0.1


@dataclass(frozen=True)
class MatchedView:
    """A view matched with a keyframe.

    Attributes:
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
