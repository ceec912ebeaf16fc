"""The last keyframes and the points they share: what carries the scale, and is adjusted as one."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.geometry import Array, inverse, rigid_transform, transform_points
from vo_service.odometry.sfm.bundle import Sightings, adjust
from vo_service.odometry.sfm.colour_view import SIGMA_PX, ColourView, RayPairs
from vo_service.odometry.sfm.keyframe import (
    NO_POINT,
    Indices,
    Keyframe,
    Points,
    find_again,
    pair_rays,
)
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.refinement import Refined
from vo_service.odometry.sfm.scale_source import median_sigma

# A new point must be as sure as this in its depth, relative: the adjustment does the rest.
NEW_TO = 0.5
# A sighting further off than this, in standard deviations, is another thing.
GATE_SIGMAS = 3.0
# One image's part of the error between two.
SIGMA_ONE_PX = SIGMA_PX / np.sqrt(2.0)
# Points are sought again in so many keyframes before the last one.
SOUGHT_IN = 4
# Fewer points than this say nothing of the scale.
FEWEST_POINTS = 15


@dataclass(frozen=True)
class Step:
    """A view that was placed by a keyframe: the matches (M, 2) that agree, and their points.

    inverse_depth  (M,) in the keyframe
    information    (M,) 1 / variance of the inverse depth
    """

    view: ColourView
    T_world_camera: Array
    matches: Indices
    inverse_depth: Array
    information: Array


def step_of(view: ColourView, T_world_camera: Array, matches: Indices, refined: Refined) -> Step:
    """What a refined motion says; `matches` (M, 2) are those that it was given."""
    ok = refined.inlier
    return Step(
        view, T_world_camera, matches[ok], refined.inverse_depth[ok], refined.information[ok]
    )


class Window:
    """Keyframes, the newest last, in one world."""

    def __init__(self, parameters: SfmParameters) -> None:
        self._parameters = parameters
        self._keyframes: list[Keyframe] = []
        self._points = Points.none()

    def begin(self, view: ColourView, T_world_camera: Array) -> None:
        """The first view of a new world; the old one is forgotten."""
        self._keyframes = [Keyframe.of(view, T_world_camera)]
        self._points = Points.none()

    @property
    def keyframes(self) -> list[Keyframe]:
        """All of them, the newest first."""
        return self._keyframes[::-1]

    @property
    def is_young(self) -> bool:
        """Whether there are too few keyframes yet for the points to be sure."""
        return len(self._keyframes) < self._parameters.young_keyframes

    def pairs(self, view: ColourView, keyframe: Keyframe, matches: Indices) -> RayPairs:
        """Matched features (M, 2) of a view and of a keyframe, with the points' depths."""
        return pair_rays(view, keyframe, self._points, matches)

    def add(self, step: Step, reference: Keyframe) -> float:
        """Make a view that was placed by one of the keyframes the newest of them.

        Returns the standard deviation of the logarithm of the scale, which this adds.
        """
        keyframe = self._with_points(step, reference)
        others = [each for each in self.keyframes if each.view is not reference.view]
        for older in others[:SOUGHT_IN]:
            keyframe = find_again(keyframe, older, self._points, self._parameters.match_ratio)
        self._keyframes = [*self._keyframes, keyframe][-self._parameters.keyframes :]
        return self._adjust()

    def _with_points(self, step: Step, reference: Keyframe) -> Keyframe:
        """The view as a keyframe: it shows the reference's points, and both show new ones."""
        mine, theirs = step.matches.T
        shown = reference.point[theirs]
        sure = step.inverse_depth**2 * step.information > 1.0 / NEW_TO**2
        is_new = (shown == NO_POINT) & sure
        P_camera = reference.view.ray[theirs[is_new]] / step.inverse_depth[is_new, None]
        shown[is_new] = len(self._points) + np.arange(is_new.sum())
        self._points = self._points.with_more(transform_points(reference.T_world_camera, P_camera))
        self._keyframes = [
            each.showing(theirs, shown) if each.view is reference.view else each
            for each in self._keyframes
        ]
        return Keyframe.of(step.view, step.T_world_camera).showing(mine, shown)

    def _adjust(self) -> float:
        """Adjust all poses but the oldest, and all points; the scale stays that of the points."""
        was_known = self._forget_unseen()
        sightings, feature = self._sightings()
        T_camera_world = np.array([inverse(each.T_world_camera) for each in self._keyframes])
        before_m = self._points.position_m
        adjusted = adjust(T_camera_world, before_m, sightings)
        centre_m = self._keyframes[0].T_world_camera[:3, 3]
        log_ratio = _log_ratio(before_m[was_known], adjusted.position_m[was_known], centre_m)
        scale = float(np.exp(np.median(log_ratio))) if len(log_ratio) else 1.0
        self._points = Points(
            centre_m + scale * (adjusted.position_m - centre_m), scale**2 * adjusted.covariance
        )
        is_wrong = adjusted.squared > GATE_SIGMAS**2
        for k, T in enumerate(adjusted.T_view_world):
            wrong = feature[is_wrong & (sightings.view == k)]
            placed = replace(self._keyframes[k], T_world_camera=_scaled(T, centre_m, scale))
            self._keyframes[k] = placed.without(wrong)
        self._forget_singles()
        return median_sigma(log_ratio) if len(log_ratio) else 0.0

    def _sightings(self) -> tuple[Sightings, Indices]:
        """Who sees which point where, by point; and the feature (O,) of each."""
        seen = [np.flatnonzero(each.point != NO_POINT) for each in self._keyframes]
        view = np.repeat(np.arange(len(seen)), [len(each) for each in seen])
        pairs = list(zip(self._keyframes, seen, strict=True))
        point = np.concatenate([each.point[index] for each, index in pairs])
        image = np.concatenate([each.view.ray[index, :2] for each, index in pairs])
        order = np.argsort(point, kind="stable")
        sigma = SIGMA_ONE_PX / self._keyframes[-1].view.focal_px
        sightings = Sightings(view[order], point[order], image[order], sigma)
        return sightings, np.concatenate(seen)[order]

    def _forget_unseen(self) -> Indices:
        """Number anew the points that some keyframe shows; which of them had been adjusted."""
        shown = np.unique(np.concatenate([each.point for each in self._keyframes]))
        shown = shown[shown != NO_POINT]
        number = np.full(len(self._points) + 1, NO_POINT, np.int64)
        number[shown] = np.arange(len(shown))
        self._keyframes = [replace(each, point=number[each.point]) for each in self._keyframes]
        self._points = Points(self._points.position_m[shown], self._points.covariance[shown])
        return np.flatnonzero(self._points.covariance[:, 0, 0] > 0.0)

    def _forget_singles(self) -> None:
        """A point that only one keyframe shows is none."""
        shown = np.concatenate([each.point for each in self._keyframes])
        views = np.bincount(shown[shown != NO_POINT], minlength=len(self._points) + 1)
        views[NO_POINT] = 2
        self._keyframes = [each.without(views[each.point] < 2) for each in self._keyframes]


def _log_ratio(before_m: Array, after_m: Array, centre_m: Array) -> Array:
    """(L,) by how much points that were known came nearer to a place; none of too few points."""
    if len(before_m) < FEWEST_POINTS:
        return np.empty(0)
    before, after = (np.linalg.norm(each - centre_m, axis=1) for each in (before_m, after_m))
    ratio: Array = np.log(np.maximum(before, 1e-6)) - np.log(np.maximum(after, 1e-6))
    return ratio


def _scaled(T_camera_world: Array, centre_m: Array, scale: float) -> Array:
    """T_world_camera with its distance from a place scaled."""
    T = inverse(T_camera_world)
    return rigid_transform(T[:3, :3], centre_m + scale * (T[:3, 3] - centre_m))
