"""Keyframes, and the 3-D points that their features observe."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transform_points
from vo_service.odometry.features import match_features
from vo_service.odometry.sfm.mono_frame import PAIR_SIGMA_PX, MonoFrame, RayPairs

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
        view: The view.
        keyframe: The keyframe.
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
        keyframe: The keyframe.
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
