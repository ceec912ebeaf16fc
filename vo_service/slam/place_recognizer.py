"""Place recognition: features propose a keyframe, the dense alignment verifies it.

A wrong match would distort the whole map, so ambiguous matches are rejected.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, poses_close
from vo_service.odometry.direct.aligner import MovingView
from vo_service.odometry.direct.image_halving import halve_as_needed
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.match_verifier import GUESS_VERIFIER
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import pair_points
from vo_service.odometry.features.verification import estimate_motion, is_beyond_chance
from vo_service.slam.keyframe_database import (
    TRACKED_VELOCITY_SIGMA,
    MapKeyframe,
    PackedPoints,
    QueryFrame,
    VladVocabulary,
    extract_depth_features,
)

# Largest number of extracted features, and of stored ones with depth.
MAX_EXTRACTED_FEATURES, MAX_STORED_FEATURES = 800, 500
# Largest difference between the motions by features and by the dense alignment.
MAX_ALIGNMENT_SHIFT_M, MAX_ALIGNMENT_SHIFT_RAD = 0.04, np.radians(1.0)
# Largest standard deviation of the position.
MAX_SIGMA_M = 0.015
# A candidate with at least this share of the best one's inliers is a rival if its pose differs by
# more than this: rooms may have corners that look alike.
MIN_RIVAL_INLIER_RATIO, MIN_RIVAL_DISTANCE_M, MIN_RIVAL_DISTANCE_RAD = 0.5, 0.5, np.radians(30.0)

KeyframePoses = Mapping[int, Array]
NO_POSES: KeyframePoses = MappingProxyType({})


@dataclass(frozen=True)
class PlaceMatch:
    """A recognized keyframe, and the pose of the view relative to it.

    Attributes:
        keyframe_number: Number of the keyframe.
        T_keyframe_camera: 4x4.
        covariance: 6x6 of it, as a small motion in the camera's axes: (translation m, rotation
            rad).
        inliers: Number of features that agree.
    """

    keyframe_number: int
    T_keyframe_camera: Array
    covariance: Array
    inliers: int


@dataclass(frozen=True)
class MatchCandidate:
    """A keyframe that features of a view agree with, and the motion (4x4) by them."""

    keyframe: MapKeyframe
    T_keyframe_camera: Array
    inliers: int


class PlaceRecognizer:
    """Makes queries and keyframes of frames, and recognizes keyframes."""

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
        """Make a query of a frame; the velocity and its sigma are as in `MovingView`."""
        frame = halve_as_needed(frame)
        features = extract_depth_features(frame, self._extractor, velocity, MAX_STORED_FEATURES)
        vlad_descriptor = self._vocabulary.describe(features.descriptor_int8)
        view = MovingView.of(frame, velocity, velocity_sigma)
        return QueryFrame(features, vlad_descriptor, view)

    def create_keyframe(
        self, query: QueryFrame, number: int, world_id: int, T_world_keyframe: Array
    ) -> MapKeyframe:
        """Make a keyframe of a query.

        Args:
            query: The view.
            number: Number of the keyframe.
            world_id: Number of its world frame.
            T_world_keyframe: 4x4 pose of the optical camera in that frame, m.
        """
        return MapKeyframe(
            number=number,
            world_id=world_id,
            stamp_s=query.stamp_s,
            T_world_keyframe=T_world_keyframe,
            camera=query.camera,
            features=query.features,
            vlad_descriptor=query.vlad_descriptor,
            packed_points=tuple(PackedPoints.pack(level) for level in query.view.select_points()),
            mean_brightness=query.view.images.mean_brightness,
        )

    def recognize(
        self,
        query: QueryFrame,
        keyframes: Sequence[MapKeyframe],
        T_map_keyframe: KeyframePoses = NO_POSES,
    ) -> PlaceMatch | None:
        """Recognize the keyframe that most features agree with, if the alignment verifies it.

        Args:
            query: The view.
            keyframes: The keyframes to match.
            T_map_keyframe: 4x4 by number, for keyframes with a known pose in the map. If a rival
                among them contradicts the best one, there is no match.
        """
        candidates = list(self.find_candidates(query, keyframes))
        if not candidates:
            return None
        best = max(candidates, key=lambda candidate: candidate.inliers)
        if any(_contradicts(best, other, T_map_keyframe) for other in candidates):
            return None
        return self.verify(query, best)

    def find_candidates(
        self, query: QueryFrame, keyframes: Sequence[MapKeyframe]
    ) -> Iterator[MatchCandidate]:
        """Find the keyframes that features agree with beyond chance."""
        parameters = self._parameters
        points = query.features.to_feature_points(query.camera.fx)
        for keyframe in keyframes:
            matches = match_features(query.features, keyframe.features, parameters.match_ratio)
            of_keyframe = keyframe.features.to_feature_points(keyframe.camera.fx)
            motion = estimate_motion(pair_points(points, of_keyframe, matches), parameters)
            if is_beyond_chance(motion, GUESS_VERIFIER, parameters):
                inliers = int(motion.inlier.sum())
                yield MatchCandidate(keyframe, motion.T_reference_camera, inliers)

    def verify(self, query: QueryFrame, candidate: MatchCandidate) -> PlaceMatch | None:
        """Align the view with a candidate; None if the alignment is not reliable."""
        keyframe = candidate.keyframe
        aligned = query.view.align(keyframe.alignment_points, keyframe, candidate.T_keyframe_camera)
        if (
            aligned is None
            or not poses_close(
                aligned.T_keyframe_camera,
                candidate.T_keyframe_camera,
                MAX_ALIGNMENT_SHIFT_M,
                MAX_ALIGNMENT_SHIFT_RAD,
            )
            or np.trace(aligned.covariance[:3, :3]) > MAX_SIGMA_M**2
        ):
            return None
        return PlaceMatch(
            keyframe.number, aligned.T_keyframe_camera, aligned.covariance, candidate.inliers
        )


def _contradicts(
    best: MatchCandidate, other: MatchCandidate, T_map_keyframe: KeyframePoses
) -> bool:
    """Whether another candidate with about as many inliers puts the camera elsewhere."""
    if other.inliers < MIN_RIVAL_INLIER_RATIO * best.inliers or not (
        best.keyframe.number in T_map_keyframe and other.keyframe.number in T_map_keyframe
    ):
        return False
    T, T_other = (T_map_keyframe[s.keyframe.number] @ s.T_keyframe_camera for s in (best, other))
    return not poses_close(T, T_other, MIN_RIVAL_DISTANCE_M, MIN_RIVAL_DISTANCE_RAD)
