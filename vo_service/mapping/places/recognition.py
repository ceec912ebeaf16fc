"""Knowing a place again: features say that it may be, the dense alignment whether it is.

A wrong recognition bends the whole map: whatever can be doubted is none.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, adjoint, inverse, rotation_angle_rad
from vo_service.mapping.places.landmarks import find_landmarks
from vo_service.mapping.places.place import PackedPoints, Place
from vo_service.mapping.places.view import PlaceView
from vo_service.mapping.places.words import Words
from vo_service.odometry.chance import ChanceTest
from vo_service.odometry.keyframe.alignment import Alignment, Tie, align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.certainty import certainty
from vo_service.odometry.keyframe.confidence import cover, doubt
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.parameters import VELOCITY_SIGMA
from vo_service.odometry.keyframe.points import find_points
from vo_service.odometry.matching import match_features
from vo_service.odometry.parameters import SurfParameters
from vo_service.odometry.points import pair_points
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.refinement import refine_motion
from vo_service.odometry.surf import SurfExtractor

# Features sought in a view, and kept at most.
SOUGHT, KEPT = 800, 500
SIGHTED = ChanceTest(if_right=0.2, by_chance=0.03)
MOST_APART_M, MOST_APART_RAD = 0.05, np.radians(3.0)


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

    def view(self, frame: RgbdFrame, velocity: Array) -> PlaceView:
        """Look at a frame; velocity (6,) is the twist of the camera in its own axes."""
        landmarks = find_landmarks(frame, self._extractor, velocity, KEPT)
        summary = self._words.summary(landmarks.look)
        return PlaceView(landmarks, summary, make_images(frame), velocity)

    def place(self, view: PlaceView, number: int, world: int, T_world_place: Array) -> Place:
        """Make a place of a view."""
        points = find_points(view.images, view.velocity, ALL_STILL)
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

    def recognise(self, view: PlaceView, places: Sequence[Place]) -> Recognition | None:
        """The place that most features agree with, if the view can be laid on it."""
        sightings = list(self.sightings(view, places))
        if not sightings:
            return None
        return self._confirm(view, max(sightings, key=lambda sighting: sighting.inliers))

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
            if inliers >= parameters.min_inliers and SIGHTED.is_passed(inliers, len(matches)):
                yield Sighting(place, motion.T_reference_camera, inliers)

    def _confirm(self, view: PlaceView, sighting: Sighting) -> Recognition | None:
        """Lay the view on the place."""
        place, points = sighting.place, sighting.place.keyframe_points
        T_camera_place = inverse(sighting.T_place_camera)
        velocity = -adjoint(sighting.T_place_camera) @ view.velocity
        tie = Tie(
            sighting.T_place_camera, 0.0, velocity, np.repeat(np.array(VELOCITY_SIGMA) ** -2.0, 3)
        )
        light = (view.images.light_against(place), 0.0)
        found = align(points, view.images, [T_camera_place], tie, light, all_alike())
        if doubt(found) or cover(found) or _apart(found, sighting):
            return None
        sure = certainty(points, view.images, found, tie, np.array(VELOCITY_SIGMA))
        if sure.doubt:
            return None
        T_place_camera = inverse(found.T_camera_keyframe)
        return Recognition(place.number, T_place_camera, sure.covariance, sighting.inliers)


def _apart(found: Alignment, sighting: Sighting) -> bool:
    """Whether brightness and depth say something else than features do."""
    T = found.T_camera_keyframe @ sighting.T_place_camera
    return bool(
        np.linalg.norm(T[:3, 3]) > MOST_APART_M or rotation_angle_rad(T[:3, :3]) > MOST_APART_RAD
    )
