"""Recovery of a frame that does not fit the last good one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.feature_points import pair_points
from vo_service.odometry.feature_view import (
    FeatureView,
    make_tracking_debug,
    select_pairs_with_depth,
)
from vo_service.odometry.match_verification import MatchVerifier
from vo_service.odometry.matching import match_features
from vo_service.odometry.motion_model import ConstantVelocityModel
from vo_service.odometry.motion_refinement import RigidMotionEstimate, refine_rigid_motion
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.surf.guided_matching import match_by_prediction
from vo_service.odometry.surf.parameters import SurfParameters
from vo_service.odometry.surf.recent_views import RecentViews
from vo_service.types import TrackingDebug

# Features of an older view are matched in the whole image: the values of Brown and Lowe.
OLDER_VIEW_VERIFIER = MatchVerifier(inlier_share_if_right=0.6, inlier_share_by_chance=0.1)
# The weaker ratio test of guided matching gives more wrong matches; but in a circle of 24 pixels or
# more, few of them are within the 2 pixels of an inlier.
PREDICTION_VERIFIER = MatchVerifier(inlier_share_if_right=0.15, inlier_share_by_chance=0.01)


@dataclass(frozen=True)
class RecoveredPose:
    """Pose of a frame.

    Attributes:
        T_world_camera: 4x4.
        T_last_camera: 4x4 motion since the last good frame.
        covariance: 6x6 of T_last_camera, as that of an `Estimate`.
        debug: Matches with the view that the pose is from.
    """

    T_world_camera: Array
    T_last_camera: Array
    covariance: Array
    debug: TrackingDebug


class SurfRecovery:
    """Recovery of the camera's pose by a prediction, or by an older view.

    It is updated with every good frame.
    """

    def __init__(self, parameters: SurfParameters) -> None:
        self._parameters = parameters
        self._model = ConstantVelocityModel()
        self._recent_views = RecentViews()
        self._T_world_last = np.eye(4)

    def reset(self, view: FeatureView, T_world_camera: Array) -> None:
        """Start a new chain of views."""
        self._model.reset(view.stamp_s)
        self._recent_views.reset(view, T_world_camera)
        self._T_world_last = T_world_camera

    def add(
        self, view: FeatureView, T_world_camera: Array, T_last_camera: Array, covariance: Array
    ) -> None:
        """Add a good view, with the motion since the last one and its covariance."""
        self._model.add(T_last_camera, view.stamp_s)
        self._recent_views.add(view, T_world_camera, T_last_camera, covariance)
        self._T_world_last = T_world_camera

    def recover(self, view: FeatureView, last: FeatureView, turn: int) -> RecoveredPose | None:
        """Recover by the last view, else by an older one, selected by `turn`; None if both fail."""
        return self._recover_by_prediction(view, last) or self._recover_by_older_view(
            view, last, turn
        )

    def _recover_by_prediction(self, view: FeatureView, last: FeatureView) -> RecoveredPose | None:
        """Match the last view again, near the features' predicted positions only."""
        prediction = self._model.predict(view.stamp_s)
        if prediction is None:
            return None
        matches = match_by_prediction(view, last, prediction)
        motion = self._estimate_motion(view, last, matches)
        if not self._is_verified(motion, PREDICTION_VERIFIER):
            return None
        T_last_camera = motion.T_reference_camera
        return RecoveredPose(
            T_world_camera=self._T_world_last @ T_last_camera,
            T_last_camera=T_last_camera,
            covariance=motion.covariance,
            debug=make_tracking_debug(view, last, matches, motion),
        )

    def _recover_by_older_view(
        self, view: FeatureView, last: FeatureView, turn: int
    ) -> RecoveredPose | None:
        """Match an older view without a prediction: the camera may have turned back."""
        older_views = self._recent_views.excluding(last)
        if not older_views:
            return None
        older_view = older_views[turn % len(older_views)]
        pairs = match_features(
            view.features, older_view.view.features, self._parameters.match_ratio
        )
        matches = select_pairs_with_depth(view, older_view.view, pairs)
        motion = self._estimate_motion(view, older_view.view, matches)
        if not self._is_verified(motion, OLDER_VIEW_VERIFIER):
            return None
        T_world_camera = older_view.T_world_view @ motion.T_reference_camera
        T_last_camera = inverse(self._T_world_last) @ T_world_camera
        return RecoveredPose(
            T_world_camera=T_world_camera,
            T_last_camera=T_last_camera,
            covariance=transport_covariance(older_view.covariance, T_last_camera)
            + motion.covariance,
            debug=make_tracking_debug(view, older_view.view, matches, motion),
        )

    def _estimate_motion(
        self, view: FeatureView, reference: FeatureView, matches: NDArray[np.int64]
    ) -> RigidMotionEstimate:
        pairs = pair_points(view.points, reference.points, matches)
        consensus = find_consensus(pairs, self._parameters.max_hypotheses, self._parameters.seed)
        return refine_rigid_motion(consensus, pairs)

    def _is_verified(self, motion: RigidMotionEstimate, verifier: MatchVerifier) -> bool:
        inliers = int(motion.inlier.sum())
        return inliers >= self._parameters.min_inliers and verifier.accepts(
            inliers, matches=len(motion.inlier)
        )
