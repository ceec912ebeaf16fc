"""The last keyframes and the points they share: what carries the scale, and is adjusted as one."""

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
from vo_service.odometry.sfm.scale_source import median_sigma
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate

# A new point must be as sure as this in its depth, relative: the adjustment does the rest.
MAX_NEW_RELATIVE_DEPTH_SIGMA = 0.5
# A sighting further off than this, in standard deviations, is another thing.
GATE_SIGMAS = 3.0
# One image's part of the error between two.
OBSERVATION_SIGMA_PX = PAIR_SIGMA_PX / np.sqrt(2.0)
# Points are sought again in so many keyframes before the last one.
MAX_SEARCHED_KEYFRAMES = 4
# Fewer points than this say nothing of the scale.
MIN_SCALE_POINTS = 15


@dataclass(frozen=True)
class KeyframeCandidate:
    """A view that was placed by a keyframe: the matches (M, 2) that agree, and their points.

    inverse_depth  (M,) in the keyframe
    information    (M,) 1 / variance of the inverse depth
    """

    view: MonoFrame
    T_world_camera: Array
    matches: Indices
    inverse_depth: Array
    information: Array


def make_keyframe_candidate(
    view: MonoFrame, T_world_camera: Array, matches: Indices, two_view: TwoViewEstimate
) -> KeyframeCandidate:
    """What a refined motion says; `matches` (M, 2) are those that it was given."""
    ok = two_view.inlier
    return KeyframeCandidate(
        view, T_world_camera, matches[ok], two_view.inverse_depth[ok], two_view.information[ok]
    )


class KeyframeWindow:
    """Keyframes, the newest last, in one world."""

    def __init__(self, parameters: SfmParameters) -> None:
        self._parameters = parameters
        self._keyframes: list[SfmKeyframe] = []
        self._points = SfmPoints.empty()

    def reset(self, view: MonoFrame, T_world_camera: Array) -> None:
        """The first view of a new world; the old one is forgotten."""
        self._keyframes = [SfmKeyframe.from_view(view, T_world_camera)]
        self._points = SfmPoints.empty()

    @property
    def keyframes(self) -> list[SfmKeyframe]:
        """All of them, the newest first."""
        return self._keyframes[::-1]

    @property
    def is_initial(self) -> bool:
        """Whether there are too few keyframes yet for the points to be sure."""
        return len(self._keyframes) < self._parameters.initial_keyframes

    def pair_rays(self, view: MonoFrame, keyframe: SfmKeyframe, matches: Indices) -> RayPairs:
        """Matched features (M, 2) of a view and of a keyframe, with the points' depths."""
        return pair_rays(view, keyframe, self._points, matches)

    def add(self, candidate: KeyframeCandidate, reference: SfmKeyframe) -> float:
        """Make a view that was placed by one of the keyframes the newest of them.

        Returns the standard deviation of the logarithm of the scale, which this adds.
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
        """The view as a keyframe: it shows the reference's points, and both show new ones."""
        mine, theirs = candidate.matches.T
        shown = reference.point_index[theirs]
        sure = (
            candidate.inverse_depth**2 * candidate.information
            > 1.0 / MAX_NEW_RELATIVE_DEPTH_SIGMA**2
        )
        is_new = (shown == NO_POINT) & sure
        P_camera = reference.view.ray[theirs[is_new]] / candidate.inverse_depth[is_new, None]
        shown[is_new] = len(self._points) + np.arange(is_new.sum())
        self._points = self._points.extended_by(
            transform_points(reference.T_world_camera, P_camera)
        )
        self._keyframes = [
            each.with_observations(theirs, shown) if each.view is reference.view else each
            for each in self._keyframes
        ]
        return SfmKeyframe.from_view(candidate.view, candidate.T_world_camera).with_observations(
            mine, shown
        )

    def _adjust_bundle(self) -> float:
        """Adjust all poses but the oldest, and all points; the scale stays that of the points."""
        was_known = self._remove_unobserved_points()
        sightings, feature = self._observations()
        T_camera_world = np.array([inverse(each.T_world_camera) for each in self._keyframes])
        before_m = self._points.position_m
        adjusted = adjust_bundle(T_camera_world, before_m, sightings)
        centre_m = self._keyframes[0].T_world_camera[:3, 3]
        log_ratio = _log_scale_ratio(before_m[was_known], adjusted.position_m[was_known], centre_m)
        scale = float(np.exp(np.median(log_ratio))) if len(log_ratio) else 1.0
        self._points = SfmPoints(
            centre_m + scale * (adjusted.position_m - centre_m), scale**2 * adjusted.covariance
        )
        is_wrong = adjusted.squared_error > GATE_SIGMAS**2
        for k, T in enumerate(adjusted.T_view_world):
            wrong = feature[is_wrong & (sightings.view == k)]
            placed = replace(self._keyframes[k], T_world_camera=_scale_pose(T, centre_m, scale))
            self._keyframes[k] = placed.without_observations(wrong)
        self._remove_single_observations()
        return median_sigma(log_ratio) if len(log_ratio) else 0.0

    def _observations(self) -> tuple[BundleObservations, Indices]:
        """Who sees which point where, by point; and the feature (O,) of each."""
        seen = [np.flatnonzero(each.point_index != NO_POINT) for each in self._keyframes]
        view = np.repeat(np.arange(len(seen)), [len(each) for each in seen])
        pairs = list(zip(self._keyframes, seen, strict=True))
        point = np.concatenate([each.point_index[index] for each, index in pairs])
        image = np.concatenate([each.view.ray[index, :2] for each, index in pairs])
        order = np.argsort(point, kind="stable")
        sigma = OBSERVATION_SIGMA_PX / self._keyframes[-1].view.focal_px
        sightings = BundleObservations(view[order], point[order], image[order], sigma)
        return sightings, np.concatenate(seen)[order]

    def _remove_unobserved_points(self) -> Indices:
        """Number anew the points that some keyframe shows; which of them had been adjusted."""
        shown = np.unique(np.concatenate([each.point_index for each in self._keyframes]))
        shown = shown[shown != NO_POINT]
        number = np.full(len(self._points) + 1, NO_POINT, np.int64)
        number[shown] = np.arange(len(shown))
        self._keyframes = [
            replace(each, point_index=number[each.point_index]) for each in self._keyframes
        ]
        self._points = SfmPoints(self._points.position_m[shown], self._points.covariance[shown])
        return np.flatnonzero(self._points.covariance[:, 0, 0] > 0.0)

    def _remove_single_observations(self) -> None:
        """A point that only one keyframe shows is none."""
        shown = np.concatenate([each.point_index for each in self._keyframes])
        views = np.bincount(shown[shown != NO_POINT], minlength=len(self._points) + 1)
        views[NO_POINT] = 2
        self._keyframes = [
            each.without_observations(views[each.point_index] < 2) for each in self._keyframes
        ]


def _log_scale_ratio(before_m: Array, after_m: Array, centre_m: Array) -> Array:
    """(L,) by how much points that were known came nearer to a place; none of too few points."""
    if len(before_m) < MIN_SCALE_POINTS:
        return np.empty(0)
    before, after = (np.linalg.norm(each - centre_m, axis=1) for each in (before_m, after_m))
    ratio: Array = np.log(np.maximum(before, 1e-6)) - np.log(np.maximum(after, 1e-6))
    return ratio


def _scale_pose(T_camera_world: Array, centre_m: Array, scale: float) -> Array:
    """T_world_camera with its distance from a place scaled."""
    T = inverse(T_camera_world)
    return rigid_transform(T[:3, :3], centre_m + scale * (T[:3, 3] - centre_m))
