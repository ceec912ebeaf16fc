"""Knowing a place again: features say that it may be, the dense alignment whether it is.

A wrong recognition bends the whole map: whatever can be doubted is none.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, are_near, inverse
from vo_service.mapping.places.landmarks import find_landmarks
from vo_service.mapping.places.place import PackedPoints, Place
from vo_service.mapping.places.view import FOLLOWED, PlaceView
from vo_service.mapping.places.words import Words
from vo_service.odometry.keyframe.alignment import (
    Alignment,
    Tie,
    align,
    all_alike,
    known_within,
)
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.certainty import certainty
from vo_service.odometry.keyframe.confidence import cover, doubt
from vo_service.odometry.keyframe.features import IS_SIGHTED
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.measure import IN_IMAGE
from vo_service.odometry.keyframe.movement import at_constant, in_axes
from vo_service.odometry.keyframe.parameters import VELOCITY_SIGMA
from vo_service.odometry.keyframe.points import find_points
from vo_service.odometry.matching import match_features
from vo_service.odometry.parameters import SurfParameters
from vo_service.odometry.points import pair_points
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.refinement import refine_motion
from vo_service.odometry.surf import SurfExtractor

# Features sought in a view, and those kept of them that have depth.
SOUGHT, KEPT = 800, 500
# This share of the place at least is in view.
LEAST_IN_VIEW = 0.3
# Features and the dense alignment agree to this,
MOST_APART_M, MOST_APART_RAD = 0.04, np.radians(1.0)
# and the place is known to this: the standard deviation in space.
MOST_SIGMA_M = 0.015
# Another place with this share of the best one's features is a rival if the camera would be so far
# from where the best one puts it: rooms may have corners that look the same.
RIVAL, ELSEWHERE_M, ELSEWHERE_RAD = 0.5, 0.5, np.radians(30.0)

Poses = Mapping[int, Array]
NOWHERE: Poses = MappingProxyType({})


@dataclass(frozen=True)
class Recognition:
    """That a view shows a place, and from where.

    number          of the place
    T_place_camera  4x4
    covariance      6x6 of it, as a small motion in the camera's axes: (translation m, rotation rad)
    inliers         features that agree
    """

    number: int
    T_place_camera: Array
    covariance: Array
    inliers: int


@dataclass(frozen=True)
class Sighting:
    """A place that features of a view agree with, and the motion (4x4) that they give."""

    place: Place
    T_place_camera: Array
    inliers: int


class Recogniser:
    """Makes views and places of frames, and knows places again."""

    def __init__(self) -> None:
        self._extractor = SurfExtractor(SOUGHT)
        self._words = Words.shipped()
        self._parameters = SurfParameters()

    def view(
        self, frame: RgbdFrame, velocity: Array, known_to: tuple[float, float] = FOLLOWED
    ) -> PlaceView:
        """Look at a frame; the velocity and how well it is known are as in `PlaceView`."""
        landmarks = find_landmarks(frame, self._extractor, velocity, KEPT)
        summary = self._words.summary(landmarks.look)
        return PlaceView(landmarks, summary, make_images(frame), velocity, known_to)

    def place(self, view: PlaceView, number: int, world: int, T_world_place: Array) -> Place:
        """Make a place of a view."""
        points = find_points(view.images, at_constant(view.velocity), ALL_STILL)
        return Place(
            number=number,
            world=world,
            stamp_s=view.stamp_s,
            T_world_place=T_world_place,
            camera=view.camera,
            landmarks=view.landmarks,
            summary=view.summary,
            packed_points=tuple(PackedPoints.of(level) for level in points),
            mean_brightness=view.images.mean_brightness,
        )

    def recognise(
        self, view: PlaceView, places: Sequence[Place], T_map_place: Poses = NOWHERE
    ) -> Recognition | None:
        """The place that most features agree with, if the view can be laid on it.

        T_map_place  4x4 by number, as far as it is known where the places are: if another place
                     says about as clearly that the camera is elsewhere, none is recognised
        """
        sightings = list(self.sightings(view, places))
        if not sightings:
            return None
        best = max(sightings, key=lambda sighting: sighting.inliers)
        if any(_contradict(best, other, T_map_place) for other in sightings):
            return None
        return self.confirm(view, best)

    def sightings(self, view: PlaceView, places: Sequence[Place]) -> Iterator[Sighting]:
        """The places that features agree with beyond chance."""
        parameters = self._parameters
        points = view.landmarks.points(view.camera.fx)
        for place in places:
            pairs = match_features(view.landmarks, place.landmarks, parameters.match_ratio)
            matches = pair_points(points, place.landmarks.points(place.camera.fx), pairs)
            consensus = find_consensus(matches, parameters.max_hypotheses, parameters.seed)
            motion = refine_motion(consensus, matches)
            inliers = int(motion.inlier.sum())
            if inliers >= parameters.min_inliers and IS_SIGHTED.is_passed(inliers, len(matches)):
                yield Sighting(place, motion.T_reference_camera, inliers)

    def confirm(self, view: PlaceView, sighting: Sighting) -> Recognition | None:
        """Lay the view on the place, and believe it only where nothing speaks against it."""
        place, points = sighting.place, sighting.place.keyframe_points
        tie = _tie(view, sighting.T_place_camera)
        start = inverse(sighting.T_place_camera)
        light = (view.images.light_against(place), 0.0)
        found = align(points, view.images, [start], tie, light, all_alike())
        T_place_camera = inverse(found.T_camera_keyframe)
        if _is_doubtful(found) or not are_near(
            T_place_camera, sighting.T_place_camera, MOST_APART_M, MOST_APART_RAD
        ):
            return None
        sure = certainty(points, view.images, found, tie, np.array(VELOCITY_SIGMA))
        if sure.doubt or np.trace(sure.covariance[:3, :3]) > MOST_SIGMA_M**2:
            return None
        return Recognition(place.number, T_place_camera, sure.covariance, sighting.inliers)


def _contradict(best: Sighting, other: Sighting, T_map_place: Poses) -> bool:
    """Whether another sighting of about as many features puts the camera elsewhere in the map."""
    if other.inliers < RIVAL * best.inliers or not (
        best.place.number in T_map_place and other.place.number in T_map_place
    ):
        return False
    T, T_other = (T_map_place[s.place.number] @ s.T_place_camera for s in (best, other))
    return not are_near(T, T_other, ELSEWHERE_M, ELSEWHERE_RAD)


def _tie(view: PlaceView, T_place_camera: Array) -> Tie:
    """What is known of the velocity: no frame before ties it to the motion."""
    movement = in_axes(at_constant(-view.velocity), T_place_camera)
    return Tie(T_place_camera, 0.0, movement, known_within(np.array(view.known_to)))


def _is_doubtful(found: Alignment) -> bool:
    """Whether an alignment says too little: stricter than the odometry, which knows the way."""
    in_view = found.counts[IN_IMAGE] / max(len(found.readings), 1)
    return bool(doubt(found) or cover(found) or in_view < LEAST_IN_VIEW)
