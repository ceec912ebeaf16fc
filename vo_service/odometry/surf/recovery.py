"""Recovery of a frame that does not fit the last good one, by a prediction or an older view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.features import (
    FeatureView,
    MatchVerifier,
    SurfParameters,
    make_tracking_debug,
    match_features,
    pair_points,
    select_pairs_with_depth,
)
from vo_service.odometry.motion_model import ConstantVelocityModel
from vo_service.odometry.ransac import RigidMotionEstimate, find_consensus, refine_rigid_motion
from vo_service.odometry.surf.guided_matching import match_by_prediction
from vo_service.types import TrackingDebug

# Features of an older view are matched in the whole image: the values of Brown and Lowe.
OLDER_VIEW_VERIFIER = MatchVerifier(inlier_share_if_right=0.6, inlier_share_by_chance=0.1)
# The weaker ratio test of guided matching gives more wrong matches; but in a circle of 24 pixels or
# more, few of them are within the 2 pixels of an inlier.
PREDICTION_VERIFIER = MatchVerifier(inlier_share_if_right=0.15, inlier_share_by_chance=0.01)
# Largest number of views.
MAX_VIEWS = 6
# No two views are nearer to each other than both of these.
MIN_DISTANCE_M, MIN_ANGLE_RAD = 0.3, np.radians(12.0)


@dataclass(frozen=True)
class RecentView:
    """A view with its pose.

    Attributes:
        view: Features and points.
        T_world_view: 4x4.
        covariance: 6x6 of the motion from this view to the last good one, (translation m, rotation
            rad), as a small motion in the last good camera's axes.
    """

    view: FeatureView
    T_world_view: Array
    covariance: Array


class RecentViews:
    """One view per place in one world frame, ordered by the camera's last visit."""

    def __init__(self) -> None:
        self._views: list[FeatureView] = []
        self._T_world_view = np.empty((0, 4, 4))
        self._covariance = np.empty((0, 6, 6))

    def reset(self, view: FeatureView, T_world_camera: Array) -> None:
        """Drop all views and start a new world frame with this one."""
        self._views = [view]
        self._T_world_view = T_world_camera[None]
        self._covariance = np.zeros((1, 6, 6))

    def add(
        self, view: FeatureView, T_world_camera: Array, T_last_camera: Array, covariance: Array
    ) -> None:
        """Add a good view, with the motion since the last one and its covariance."""
        self._covariance = transport_covariance(self._covariance, T_last_camera) + covariance
        is_near = self._is_near(T_world_camera)
        if not is_near.any():
            self._views.append(view)
            self._T_world_view = np.concatenate([self._T_world_view, T_world_camera[None]])
            self._covariance = np.concatenate([self._covariance, np.zeros((1, 6, 6))])
            is_near = np.append(is_near, True)
        if not is_near[-1] or len(self._views) > MAX_VIEWS:
            self._retain(np.argsort(is_near, kind="stable")[-MAX_VIEWS:])

    def excluding(self, last: FeatureView) -> list[RecentView]:
        """All views except one, the most recently visited first."""
        views = zip(self._views, self._T_world_view, self._covariance, strict=True)
        return [RecentView(view, T, C) for view, T, C in reversed(list(views)) if view is not last]

    def _is_near(self, T_world_camera: Array) -> NDArray[np.bool_]:
        distance_m = np.linalg.norm(self._T_world_view[:, :3, 3] - T_world_camera[:3, 3], axis=1)
        # The trace of the rotation between is 1 + 2 cos(angle).
        trace = np.einsum("kij,ij->k", self._T_world_view[:, :3, :3], T_world_camera[:3, :3])
        is_near: NDArray[np.bool_] = (distance_m < MIN_DISTANCE_M) & (
            trace > 1.0 + 2.0 * np.cos(MIN_ANGLE_RAD)
        )
        return is_near

    def _retain(self, indices: NDArray[np.intp]) -> None:
        self._views = [self._views[k] for k in indices]
        self._T_world_view, self._covariance = (
            self._T_world_view[indices],
            self._covariance[indices],
        )


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
            debug=make_tracking_debug(view, last, matches, motion.inlier),
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
            debug=make_tracking_debug(view, older_view.view, matches, motion.inlier),
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
