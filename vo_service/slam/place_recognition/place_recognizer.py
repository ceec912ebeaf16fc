"""Knowing a place again: features say that it may be, the dense alignment whether it is.

A wrong recognition bends the whole map: whatever can be doubted is none.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, poses_close
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    MotionPrior,
    align,
    uniform_weights,
    velocity_information,
)
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.feature_search import FEATURE_MATCH_VERIFIER
from vo_service.odometry.direct.grid import ALL_STATIC
from vo_service.odometry.direct.image_pyramid import build_image_pyramid
from vo_service.odometry.direct.keyframe_points import select_points
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.quality import occlusion_reason, rejection_reason
from vo_service.odometry.direct.residual_stats import IN_IMAGE
from vo_service.odometry.direct.rolling_shutter import change_frame, constant_velocity_motion
from vo_service.odometry.feature_points import pair_points
from vo_service.odometry.matching import match_features
from vo_service.odometry.motion_refinement import refine_rigid_motion
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.surf.parameters import SurfParameters
from vo_service.slam.place_recognition.depth_features import extract_depth_features
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe, PackedPoints
from vo_service.slam.place_recognition.query_frame import TRACKED_VELOCITY_SIGMA, QueryFrame
from vo_service.slam.place_recognition.vlad import VladVocabulary

# Features sought in a view, and those kept of them that have depth.
MAX_EXTRACTED_FEATURES, MAX_STORED_FEATURES = 800, 500
# This share of the place at least is in view.
MIN_OVERLAP = 0.3
# Features and the dense alignment agree to this,
MAX_ALIGNMENT_SHIFT_M, MAX_ALIGNMENT_SHIFT_RAD = 0.04, np.radians(1.0)
# and the place is known to this: the standard deviation in space.
MAX_SIGMA_M = 0.015
# Another place with this share of the best one's features is a rival if the camera would be so far
# from where the best one puts it: rooms may have corners that look the same.
MIN_RIVAL_INLIER_RATIO, MIN_RIVAL_DISTANCE_M, MIN_RIVAL_DISTANCE_RAD = 0.5, 0.5, np.radians(30.0)

KeyframePoses = Mapping[int, Array]
NO_POSES: KeyframePoses = MappingProxyType({})


@dataclass(frozen=True)
class PlaceMatch:
    """That a view shows a place, and from where.

    number          of the place
    T_place_camera  4x4
    covariance      6x6 of it, as a small motion in the camera's axes: (translation m, rotation rad)
    inliers         features that agree
    """

    keyframe_number: int
    T_keyframe_camera: Array
    covariance: Array
    inliers: int


@dataclass(frozen=True)
class MatchCandidate:
    """A place that features of a view agree with, and the motion (4x4) that they give."""

    keyframe: MapKeyframe
    T_keyframe_camera: Array
    inliers: int


class PlaceRecognizer:
    """Makes views and places of frames, and knows places again."""

    def __init__(self) -> None:
        self._extractor = SurfExtractor(MAX_EXTRACTED_FEATURES)
        self._vocabulary = VladVocabulary.default()
        self._parameters = SurfParameters()

    def create_query(
        self,
        frame: RgbdFrame,
        velocity: Array,
        velocity_sigma: tuple[float, float] = TRACKED_VELOCITY_SIGMA,
    ) -> QueryFrame:
        """Look at a frame; the velocity and how well it is known are as in `QueryFrame`."""
        landmarks = extract_depth_features(frame, self._extractor, velocity, MAX_STORED_FEATURES)
        summary = self._vocabulary.describe(landmarks.descriptor_int8)
        return QueryFrame(landmarks, summary, build_image_pyramid(frame), velocity, velocity_sigma)

    def create_keyframe(
        self, query: QueryFrame, number: int, world_id: int, T_world_keyframe: Array
    ) -> MapKeyframe:
        """Make a place of a view."""
        points = select_points(
            query.image_pyramid, constant_velocity_motion(query.velocity), ALL_STATIC
        )
        return MapKeyframe(
            number=number,
            world_id=world_id,
            stamp_s=query.stamp_s,
            T_world_keyframe=T_world_keyframe,
            camera=query.camera,
            features=query.features,
            vlad_descriptor=query.vlad_descriptor,
            packed_points=tuple(PackedPoints.pack(level) for level in points),
            mean_brightness=query.image_pyramid.mean_brightness,
        )

    def recognize(
        self,
        query: QueryFrame,
        keyframes: Sequence[MapKeyframe],
        T_map_keyframe: KeyframePoses = NO_POSES,
    ) -> PlaceMatch | None:
        """The place that most features agree with, if the view can be laid on it.

        T_map_place  4x4 by number, as far as it is known where the places are: if another place
                     says about as clearly that the camera is elsewhere, none is recognised
        """
        sightings = list(self.find_candidates(query, keyframes))
        if not sightings:
            return None
        best = max(sightings, key=lambda sighting: sighting.inliers)
        if any(_contradicts(best, other, T_map_keyframe) for other in sightings):
            return None
        return self.verify(query, best)

    def find_candidates(
        self, query: QueryFrame, keyframes: Sequence[MapKeyframe]
    ) -> Iterator[MatchCandidate]:
        """The places that features agree with beyond chance."""
        parameters = self._parameters
        points = query.features.to_feature_points(query.camera.fx)
        for place in keyframes:
            pairs = match_features(query.features, place.features, parameters.match_ratio)
            matches = pair_points(points, place.features.to_feature_points(place.camera.fx), pairs)
            consensus = find_consensus(matches, parameters.max_hypotheses, parameters.seed)
            motion = refine_rigid_motion(consensus, matches)
            inliers = int(motion.inlier.sum())
            if inliers >= parameters.min_inliers and FEATURE_MATCH_VERIFIER.accepts(
                inliers, len(matches)
            ):
                yield MatchCandidate(place, motion.T_reference_camera, inliers)

    def verify(self, query: QueryFrame, candidate: MatchCandidate) -> PlaceMatch | None:
        """Lay the view on the place, and believe it only where nothing speaks against it."""
        place, points = candidate.keyframe, candidate.keyframe.alignment_points
        tie = _motion_prior(query, candidate.T_keyframe_camera)
        start = inverse(candidate.T_keyframe_camera)
        light = (query.image_pyramid.brightness_ratio(place), 0.0)
        found = align(points, query.image_pyramid, [start], tie, light, uniform_weights())
        T_place_camera = inverse(found.T_camera_keyframe)
        if _is_unreliable(found) or not poses_close(
            T_place_camera,
            candidate.T_keyframe_camera,
            MAX_ALIGNMENT_SHIFT_M,
            MAX_ALIGNMENT_SHIFT_RAD,
        ):
            return None
        sure = estimate_uncertainty(
            points, query.image_pyramid, found, tie, np.array(VELOCITY_SIGMA)
        )
        if sure.rejection_reason or np.trace(sure.covariance[:3, :3]) > MAX_SIGMA_M**2:
            return None
        return PlaceMatch(place.number, T_place_camera, sure.covariance, candidate.inliers)


def _contradicts(
    best: MatchCandidate, other: MatchCandidate, T_map_keyframe: KeyframePoses
) -> bool:
    """Whether another sighting of about as many features puts the camera elsewhere in the map."""
    if other.inliers < MIN_RIVAL_INLIER_RATIO * best.inliers or not (
        best.keyframe.number in T_map_keyframe and other.keyframe.number in T_map_keyframe
    ):
        return False
    T, T_other = (T_map_keyframe[s.keyframe.number] @ s.T_keyframe_camera for s in (best, other))
    return not poses_close(T, T_other, MIN_RIVAL_DISTANCE_M, MIN_RIVAL_DISTANCE_RAD)


def _motion_prior(query: QueryFrame, T_keyframe_camera: Array) -> MotionPrior:
    """What is known of the velocity: no frame before ties it to the motion."""
    movement = change_frame(constant_velocity_motion(-query.velocity), T_keyframe_camera)
    return MotionPrior(
        T_keyframe_camera, 0.0, movement, velocity_information(np.array(query.velocity_sigma))
    )


def _is_unreliable(alignment: DirectAlignment) -> bool:
    """Whether an alignment says too little: stricter than the odometry, which knows the way."""
    in_view = alignment.counts[IN_IMAGE] / max(len(alignment.samples), 1)
    return bool(rejection_reason(alignment) or occlusion_reason(alignment) or in_view < MIN_OVERLAP)
