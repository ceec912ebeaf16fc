"""Place recognition: features propose a keyframe, the dense alignment verifies it.

A wrong match would distort the whole map, so ambiguous matches are rejected.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, poses_close
from vo_service.odometry.direct.alignment import DirectAlignment, align, uniform_weights
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.gauss_newton import MotionPrior, velocity_information
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.motion import change_frame, constant_velocity_motion
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.points import select_points
from vo_service.odometry.direct.quality import occlusion_reason, rejection_reason
from vo_service.odometry.direct.recovery import FEATURE_MATCH_VERIFIER
from vo_service.odometry.direct.residuals import (
    IN_IMAGE,
)
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import pair_points
from vo_service.odometry.ransac import find_consensus, refine_rigid_motion
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
# Smallest share of the keyframe's points in view.
MIN_OVERLAP = 0.3
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
        """Make a query of a frame; the velocity and its sigma are as in `QueryFrame`.

        Args:
            frame: The frame.
            velocity: (6,) see `QueryFrame`.
            velocity_sigma: See `QueryFrame`.
        """
        features = extract_depth_features(frame, self._extractor, velocity, MAX_STORED_FEATURES)
        vlad_descriptor = self._vocabulary.describe(features.descriptor_int8)
        return QueryFrame(
            features, vlad_descriptor, build_image_pyramid(frame), velocity, velocity_sigma
        )

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
            pairs = match_features(query.features, keyframe.features, parameters.match_ratio)
            matches = pair_points(
                points, keyframe.features.to_feature_points(keyframe.camera.fx), pairs
            )
            consensus = find_consensus(matches, parameters.max_hypotheses, parameters.seed)
            motion = refine_rigid_motion(consensus, matches)
            inliers = int(motion.inlier.sum())
            if inliers >= parameters.min_inliers and FEATURE_MATCH_VERIFIER.accepts(
                inliers, len(matches)
            ):
                yield MatchCandidate(keyframe, motion.T_reference_camera, inliers)

    def verify(self, query: QueryFrame, candidate: MatchCandidate) -> PlaceMatch | None:
        """Align the view with a candidate; None if the alignment is not reliable."""
        keyframe, points = candidate.keyframe, candidate.keyframe.alignment_points
        prior = _motion_prior(query, candidate.T_keyframe_camera)
        initial_guess = inverse(candidate.T_keyframe_camera)
        gain = query.image_pyramid.brightness_ratio(keyframe)
        alignment = align(
            points,
            query.image_pyramid,
            initial_guess,
            prior,
            gain,
            uniform_weights(),
        )
        T_keyframe_camera = inverse(alignment.T_camera_keyframe)
        if _is_unreliable(alignment) or not poses_close(
            T_keyframe_camera,
            candidate.T_keyframe_camera,
            MAX_ALIGNMENT_SHIFT_M,
            MAX_ALIGNMENT_SHIFT_RAD,
        ):
            return None
        uncertainty = estimate_uncertainty(
            points, query.image_pyramid, alignment, prior, np.array(VELOCITY_SIGMA)
        )
        if (
            uncertainty.rejection_reason
            or np.trace(uncertainty.covariance[:3, :3]) > MAX_SIGMA_M**2
        ):
            return None
        return PlaceMatch(
            keyframe.number, T_keyframe_camera, uncertainty.covariance, candidate.inliers
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


def _motion_prior(query: QueryFrame, T_keyframe_camera: Array) -> MotionPrior:
    """Prior of the velocity, without a last frame."""
    motion = change_frame(constant_velocity_motion(-query.velocity), T_keyframe_camera)
    return MotionPrior(
        T_keyframe_camera, 0.0, motion, velocity_information(np.array(query.velocity_sigma))
    )


def _is_unreliable(alignment: DirectAlignment) -> bool:
    """Whether an alignment is too weak; stricter than in the odometry, which has a prediction."""
    in_view = alignment.counts[IN_IMAGE] / max(len(alignment.samples), 1)
    return bool(rejection_reason(alignment) or occlusion_reason(alignment) or in_view < MIN_OVERLAP)
