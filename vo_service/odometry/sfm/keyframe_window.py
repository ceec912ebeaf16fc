"""Sliding window of keyframes and their points: it propagates the scale and is bundle adjusted."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.core.geometry import Array, inverse, rigid_transform, transform_points
from vo_service.odometry.sfm.bundle_adjustment import BundleObservations, adjust_bundle
from vo_service.odometry.sfm.keyframe import (
    NO_POINT,
    Indices,
    SfmKeyframe,
    SfmPoints,
    find_known_points,
    pair_rays,
)
from vo_service.odometry.sfm.mono_frame import PAIR_SIGMA_PX, MonoFrame, RayPairs
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.scale import median_sigma
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate

# Largest relative sigma of a new point's depth; the adjustment improves it.
MAX_NEW_RELATIVE_DEPTH_SIGMA = 0.5
# Gate of an observation, in standard deviations.
GATE_SIGMAS = 3.0
# Error of one image, where that of a pair is of two.
OBSERVATION_SIGMA_PX = PAIR_SIGMA_PX / np.sqrt(2.0)
# Number of older keyframes whose points are matched with a new one.
MAX_SEARCHED_KEYFRAMES = 4
# Fewest points for an estimate of the scale.
MIN_SCALE_POINTS = 15


@dataclass(frozen=True)
class KeyframeCandidate:
    """A registered view that may become a keyframe.

    Attributes:
        view: Features and rays.
        T_world_camera: 4x4.
        matches: (M, 2) features of the view and of its keyframe that agree.
        inverse_depth: (M,) in the keyframe, 1/m.
        information: (M,) 1 / variance of the inverse depth.
    """

    view: MonoFrame
    T_world_camera: Array
    matches: Indices
    inverse_depth: Array
    information: Array


def make_keyframe_candidate(
    view: MonoFrame, T_world_camera: Array, matches: Indices, two_view: TwoViewEstimate
) -> KeyframeCandidate:
    """Make a candidate of a refined motion and its matches (M, 2).

    Args:
        view: Features and rays.
        T_world_camera: 4x4 pose.
        matches: (M, 2) features of the view and of its keyframe.
        two_view: The refined motion between them.
    """
    ok = two_view.inlier
    return KeyframeCandidate(
        view, T_world_camera, matches[ok], two_view.inverse_depth[ok], two_view.information[ok]
    )


class KeyframeWindow:
    """Sliding window of keyframes, the newest last, in one world frame."""

    def __init__(self, parameters: SfmParameters) -> None:
        self._parameters = parameters
        self._keyframes: list[SfmKeyframe] = []
        self._points = SfmPoints.empty()

    def reset(self, view: MonoFrame, T_world_camera: Array) -> None:
        """Drop all keyframes and start a new world frame with this view."""
        self._keyframes = [SfmKeyframe.from_view(view, T_world_camera)]
        self._points = SfmPoints.empty()

    @property
    def keyframes(self) -> list[SfmKeyframe]:
        """All keyframes, the newest first."""
        return self._keyframes[::-1]

    @property
    def is_initial(self) -> bool:
        """Whether there are too few keyframes for accurate points."""
        return len(self._keyframes) < self._parameters.initial_keyframes

    def pair_rays(self, view: MonoFrame, keyframe: SfmKeyframe, matches: Indices) -> RayPairs:
        """Pair the rays of matched features (M, 2) of a view and a keyframe.

        Args:
            keyframe: A keyframe of the window.
            matches: (M, 2) features of the view and of the keyframe.
        """
        return pair_rays(view, keyframe, self._points, matches)

    def add(self, candidate: KeyframeCandidate, reference: SfmKeyframe) -> float:
        """Add a keyframe and adjust the window.

        Args:
            candidate: The view of the new keyframe.
            reference: The keyframe that it is registered against.

        Returns:
            The standard deviation of the change of the scale's logarithm.
        """
        keyframe = self._make_keyframe(candidate, reference)
        others = [each for each in self.keyframes if each.view is not reference.view]
        for older in others[:MAX_SEARCHED_KEYFRAMES]:
            keyframe = find_known_points(
                keyframe, older, self._points, self._parameters.match_ratio
            )
        self._keyframes = [*self._keyframes, keyframe][-self._parameters.max_keyframes :]
        return self._adjust_bundle()

    def _make_keyframe(self, candidate: KeyframeCandidate, reference: SfmKeyframe) -> SfmKeyframe:
        """Make a keyframe that observes the reference's points, and new points with it."""
        features, reference_features = candidate.matches.T
        observed = reference.point_index[reference_features]
        is_accurate = (
            candidate.inverse_depth**2 * candidate.information
            > 1.0 / MAX_NEW_RELATIVE_DEPTH_SIGMA**2
        )
        is_new = (observed == NO_POINT) & is_accurate
        P_camera = (
            reference.view.ray[reference_features[is_new]] / candidate.inverse_depth[is_new, None]
        )
        observed[is_new] = len(self._points) + np.arange(is_new.sum())
        self._points = self._points.extended_by(
            transform_points(reference.T_world_camera, P_camera)
        )
        self._keyframes = [
            each.with_observations(reference_features, observed)
            if each.view is reference.view
            else each
            for each in self._keyframes
        ]
        return SfmKeyframe.from_view(candidate.view, candidate.T_world_camera).with_observations(
            features, observed
        )

    def _adjust_bundle(self) -> float:
        """Adjust all points and all poses except the oldest; keep the scale of the known points."""
        adjusted_index = self._remove_unobserved_points()
        observations, feature = self._observations()
        T_camera_world = np.array([inverse(each.T_world_camera) for each in self._keyframes])
        old_m = self._points.position_m
        adjusted = adjust_bundle(T_camera_world, old_m, observations)
        center_m = self._keyframes[0].T_world_camera[:3, 3]
        log_ratio = _log_scale_ratio(
            old_m[adjusted_index], adjusted.position_m[adjusted_index], center_m
        )
        scale = float(np.exp(np.median(log_ratio))) if len(log_ratio) else 1.0
        self._points = SfmPoints(
            center_m + scale * (adjusted.position_m - center_m), scale**2 * adjusted.covariance
        )
        is_wrong = adjusted.squared_error > GATE_SIGMAS**2
        for k, T in enumerate(adjusted.T_view_world):
            wrong_features = feature[is_wrong & (observations.view_index == k)]
            keyframe = replace(self._keyframes[k], T_world_camera=_scale_pose(T, center_m, scale))
            self._keyframes[k] = keyframe.without_observations(wrong_features)
        self._remove_single_observations()
        return median_sigma(log_ratio) if len(log_ratio) else 0.0

    def _observations(self) -> tuple[BundleObservations, Indices]:
        """Observations ordered by point, and the feature index (O,) of each."""
        observing = [np.flatnonzero(each.point_index != NO_POINT) for each in self._keyframes]
        view = np.repeat(np.arange(len(observing)), [len(each) for each in observing])
        pairs = list(zip(self._keyframes, observing, strict=True))
        point = np.concatenate([each.point_index[index] for each, index in pairs])
        image = np.concatenate([each.view.ray[index, :2] for each, index in pairs])
        order = np.argsort(point, kind="stable")
        sigma = OBSERVATION_SIGMA_PX / self._keyframes[-1].view.focal_px
        observations = BundleObservations(view[order], point[order], image[order], sigma)
        return observations, np.concatenate(observing)[order]

    def _remove_unobserved_points(self) -> Indices:
        """Remove unobserved points; return the indices of the points that are already adjusted."""
        observed = np.unique(np.concatenate([each.point_index for each in self._keyframes]))
        observed = observed[observed != NO_POINT]
        new_index = np.full(len(self._points) + 1, NO_POINT, np.int64)
        new_index[observed] = np.arange(len(observed))
        self._keyframes = [
            replace(each, point_index=new_index[each.point_index]) for each in self._keyframes
        ]
        self._points = SfmPoints(
            self._points.position_m[observed], self._points.covariance[observed]
        )
        return np.flatnonzero(self._points.covariance[:, 0, 0] > 0.0)

    def _remove_single_observations(self) -> None:
        """Remove points with a single observation."""
        observed = np.concatenate([each.point_index for each in self._keyframes])
        views = np.bincount(observed[observed != NO_POINT], minlength=len(self._points) + 1)
        views[NO_POINT] = 2
        self._keyframes = [
            each.without_observations(views[each.point_index] < 2) for each in self._keyframes
        ]


def _log_scale_ratio(old_m: Array, new_m: Array, center_m: Array) -> Array:
    """(L,) logarithm of the ratio of distances to a center before and after; empty if too few."""
    if len(old_m) < MIN_SCALE_POINTS:
        return np.empty(0)
    before, after = (np.linalg.norm(each - center_m, axis=1) for each in (old_m, new_m))
    ratio: Array = np.log(np.maximum(before, 1e-6)) - np.log(np.maximum(after, 1e-6))
    return ratio


def _scale_pose(T_camera_world: Array, center_m: Array, scale: float) -> Array:
    """T_world_camera with its distance from a center scaled."""
    T = inverse(T_camera_world)
    return rigid_transform(T[:3, :3], center_m + scale * (T[:3, 3] - center_m))
