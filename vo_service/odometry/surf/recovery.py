"""Recovery of a frame that does not fit the last good one, by a prediction or an older view.

By a prediction, features are searched near their predicted positions, with a weaker ratio test: the
search by projection of Klein and Murray (PTAM, ISMAR 2007, Section 5.3).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, transform_points, transport_covariance
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.features.extractor import Features
from vo_service.odometry.features.match_verifier import LAST_VIEW_VERIFIER, MatchVerifier
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import pair_points
from vo_service.odometry.features.verification import cover_doubt, estimate_motion, rejection_reason
from vo_service.odometry.features.views import (
    FeatureView,
    make_tracking_debug,
    match_views,
    select_pairs_with_depth,
)
from vo_service.odometry.motion_model import ConstantVelocityModel, MotionPrediction
from vo_service.odometry.ransac import RigidMotionEstimate
from vo_service.types.estimate import TrackingDebug

# The second nearest descriptor in the search radius is further by 1/RATIO.
MAX_DISTANCE_RATIO = 0.9
# The nearest one, which may have no second, differs by at most this share of the descriptor's norm.
MAX_RELATIVE_DISTANCE = 0.6
# Smallest depth of a predicted point.
MIN_DEPTH_M = 0.1
# Larger than any squared difference.
INFINITE_DISTANCE = 2**62

Descriptors = NDArray[np.int16]


@dataclass(frozen=True)
class PredictedFeatures:
    """Features of the reference that are predicted in view.

    Attributes:
        index: (K,) indices of the reference's features.
        position_px: (K, 2) predicted positions.
    """

    index: NDArray[np.intp]
    position_px: Array


def match_by_prediction(
    view: FeatureView, reference: FeatureView, prediction: MotionPrediction
) -> NDArray[np.int64]:
    """Match features near their predicted positions: pairs (M, 2) of a view and its reference.

    Both have depth and each is the other's nearest; bright and dark blobs are never compared.

    Args:
        prediction: Of the motion between them.
    """
    predicted = _project_reference(view, reference, prediction)
    radius_px = view.camera.fx * float(np.tan(prediction.spread_rad))
    # Sorted by x, so that neighbors are contiguous.
    queries = np.argsort(view.features.position_px[:, 0], kind="stable")
    blocks = [np.empty((0, 2), np.int64)]
    for sign in (-1.0, 1.0):
        rows = queries[view.features.sign[queries] == sign]
        predicted_rows = np.flatnonzero(reference.features.sign[predicted.index] == sign)
        nearest = match_within_radius(
            predicted.position_px[predicted_rows],
            _descriptors(reference.features, predicted.index[predicted_rows]),
            view.features.position_px[rows].astype(np.float64),
            _descriptors(view.features, rows),
            radius_px,
        )
        matched = np.flatnonzero(nearest >= 0)
        pairs = np.column_stack([rows[nearest[matched]], predicted.index[predicted_rows[matched]]])
        blocks.append(pairs.astype(np.int64))
    pairs = select_pairs_with_depth(view, reference, np.concatenate(blocks))
    return pairs[np.argsort(pairs[:, 0], kind="stable")]


def _project_reference(
    view: FeatureView, reference: FeatureView, prediction: MotionPrediction
) -> PredictedFeatures:
    """Project the reference's points into the predicted view."""
    points, camera = reference.points, view.camera
    P_camera = transform_points(inverse(prediction.T_reference_camera), points.position_m)
    index = np.flatnonzero(points.has_depth & (P_camera[:, 2] > MIN_DEPTH_M))
    x, y, z = P_camera[index].T
    position_px = np.column_stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
    return PredictedFeatures(index, position_px)


def _descriptors(features: Features, index: NDArray[np.intp]) -> Descriptors:
    """Descriptors (N, D) of selected features as integers, whose sums are exact."""
    return features.descriptor[index].astype(np.int16)


@kernel
def match_within_radius(
    predicted_px: Array,
    predicted_descriptor: Descriptors,
    position_px: Array,
    descriptor: Descriptors,
    radius_px: float,
) -> NDArray[np.int64]:
    """Match each predicted feature within a radius.

    Args:
        predicted_px: (K, 2).
        predicted_descriptor: (K, D).
        position_px: (N, 2), ascending in x.
        descriptor: (N, D).
        radius_px: Radius of the search.

    Returns:
        (K,) the matched row of `descriptor`, -1 for none.
    """
    nearest = np.full(len(predicted_descriptor), -1, np.int64)
    closest_distance = np.full(len(descriptor), INFINITE_DISTANCE, np.int64)
    closest_row = np.full(len(descriptor), -1, np.int64)
    begin = np.searchsorted(position_px[:, 0], predicted_px[:, 0] - radius_px)
    for k in range(len(predicted_descriptor)):
        best = second = INFINITE_DISTANCE
        best_row = -1
        for n in range(begin[k], len(descriptor)):
            dx = position_px[n, 0] - predicted_px[k, 0]
            dy = position_px[n, 1] - predicted_px[k, 1]
            if dx > radius_px:
                break
            if dx * dx + dy * dy > radius_px * radius_px:
                continue
            difference = _squared_distance(predicted_descriptor[k], descriptor[n])
            if difference < best:
                best, second, best_row = difference, best, n
            elif difference < second:
                second = difference
            if difference < closest_distance[n]:
                closest_distance[n], closest_row[n] = difference, k
        squared_norm = _squared_distance(
            predicted_descriptor[k], np.zeros_like(predicted_descriptor[k])
        )
        if (
            best < MAX_DISTANCE_RATIO**2 * second
            and best <= MAX_RELATIVE_DISTANCE**2 * squared_norm
        ):
            nearest[k] = best_row
    for k in range(len(predicted_descriptor)):
        if nearest[k] >= 0 and closest_row[nearest[k]] != k:
            nearest[k] = -1
    return nearest


@inline_kernel
def _squared_distance(a: Descriptors, b: Descriptors) -> int:
    total = 0
    for d in range(len(a)):
        step = int(a[d]) - int(b[d])
        total += step * step
    return total


# Features of an older view are matched in the whole image: the values of Brown and Lowe.
OLDER_VIEW_VERIFIER = MatchVerifier(inlier_share_if_right=0.6, inlier_share_by_chance=0.1)
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
        """Add a good view, with the motion since the last one and its covariance.

        Args:
            T_world_camera: 4x4 pose.
            T_last_camera: 4x4 motion since the last good view.
            covariance: 6x6 of that motion, see `Estimate`.
        """
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
        """Add a good view, with the motion since the last one and its covariance.

        Args:
            T_world_camera: 4x4 pose.
            T_last_camera: 4x4 motion since the last good view.
            covariance: 6x6 of that motion, see `Estimate`.
        """
        self._model.add(T_last_camera, view.stamp_s)
        self._recent_views.add(view, T_world_camera, T_last_camera, covariance)
        self._T_world_last = T_world_camera

    def recover(self, view: FeatureView, last: FeatureView, turn: int) -> RecoveredPose | None:
        """Recover by the last view, else by an older one, selected by `turn`; None if both fail.

        Args:
            last: The last good view.
            turn: Number that selects the older view.
        """
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
        if rejection_reason(view, last, motion, LAST_VIEW_VERIFIER, self._parameters):
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
        matches = match_views(view, older_view.view, self._parameters.match_ratio)
        motion = self._estimate_motion(view, older_view.view, matches)
        if rejection_reason(view, older_view.view, motion, OLDER_VIEW_VERIFIER, self._parameters):
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
        return cover_doubt(estimate_motion(pairs, self._parameters), pairs, self._parameters)
