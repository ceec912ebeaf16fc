"""Views that are kept, and which of their features are which points in space."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transform_points
from vo_service.odometry.matching import match_features
from vo_service.odometry.sfm.mono_frame import PAIR_SIGMA_PX, MonoFrame, RayPairs

Indices = NDArray[np.int64]

NO_POINT = -1
# Nearer to a camera than this no point is expected.
MIN_DEPTH_M = 0.05
# A feature may be a point that projects to within so many standard deviations of it.
GATE_SIGMAS = 4.0


@dataclass(frozen=True)
class SfmKeyframe:
    """A view with its pose.

    T_world_camera  4x4
    point           (N,) which point each feature shows; -1: none yet
    """

    view: MonoFrame
    T_world_camera: Array
    point_index: Indices

    @classmethod
    def from_view(cls, view: MonoFrame, T_world_camera: Array) -> "SfmKeyframe":
        """A keyframe that shows no points yet."""
        return cls(view, T_world_camera, np.full(len(view.features), NO_POINT, np.int64))

    def with_observations(self, features: Indices, points: Indices) -> "SfmKeyframe":
        """The same, some of whose features show these points."""
        point = self.point_index.copy()
        point[features] = points
        return replace(self, point_index=point)

    def without_observations(self, features: Indices | NDArray[np.bool_]) -> "SfmKeyframe":
        """The same, some of whose features show no point."""
        point = self.point_index.copy()
        point[features] = NO_POINT
        return replace(self, point_index=point)


@dataclass(frozen=True)
class SfmPoints:
    """Points in space.

    position_m  (L, 3) in the world
    covariance  (L, 3, 3) the poses being given
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
        """The same and some more (M, 3), of which it is not known how sure they are."""
        blank = np.zeros((len(position_m), 3, 3))
        return SfmPoints(
            np.concatenate([self.position_m, position_m]),
            np.concatenate([self.covariance, blank]),
        )


def pair_rays(
    view: MonoFrame, keyframe: SfmKeyframe, points: SfmPoints, matches: Indices
) -> RayPairs:
    """Matched features (M, 2) of a view and of a keyframe, with what is known of their depth.

    A known point stands for its feature: it is where all keyframes together see it.
    """
    T_camera_world = inverse(keyframe.T_world_camera)
    ray_reference = keyframe.view.ray[matches[:, 1]].copy()
    inverse_depth, information = np.zeros((2, len(matches)))
    shown = keyframe.point_index[matches[:, 1]]
    known = np.flatnonzero(shown != NO_POINT)
    P_camera = transform_points(T_camera_world, points.position_m[shown[known]])
    in_front = P_camera[:, 2] > MIN_DEPTH_M
    known, P_camera = known[in_front], P_camera[in_front]
    z = P_camera[:, 2]
    axis = T_camera_world[2, :3]
    variance_m2 = np.einsum("i,nij,j->n", axis, points.covariance[shown[known]], axis)
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
    """The keyframe, showing also those points of an older one that it sees where they ought to be.

    The longer a point is followed, the less the scale and the pose drift.
    """
    matches = match_features(keyframe.view.features, older.view.features, ratio)
    shown = older.point_index[matches[:, 1]]
    is_new = (shown != NO_POINT) & (keyframe.point_index[matches[:, 0]] == NO_POINT)
    is_new &= ~np.isin(shown, keyframe.point_index)
    matches, shown = matches[is_new], shown[is_new]
    P_camera = transform_points(inverse(keyframe.T_world_camera), points.position_m[shown])
    z = np.maximum(P_camera[:, 2], MIN_DEPTH_M)
    error = P_camera[:, :2] / z[:, None] - keyframe.view.ray[matches[:, 0], :2]
    gate = GATE_SIGMAS * PAIR_SIGMA_PX / keyframe.view.focal_px
    fits = (P_camera[:, 2] > MIN_DEPTH_M) & (np.einsum("ni,ni->n", error, error) < gate**2)
    return keyframe.with_observations(matches[fits, 0], shown[fits])
