"""SURF odometry: features, matching, RANSAC, rigid motion by SVD, concatenated poses.

Fontes and Maia, "Visual odometry for moving RGB-D cameras", Section III.
"""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.depth_grid import DepthGrid
from vo_service.odometry.features.extractor import FeatureExtractor, SurfExtractor
from vo_service.odometry.features.match_verifier import LAST_VIEW_VERIFIER
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import backproject_features, pair_points
from vo_service.odometry.features.verification import (
    cover_doubt,
    doubt_reason,
    estimate_motion,
    rejection_reason,
)
from vo_service.odometry.features.views import (
    FeatureView,
    make_tracking_debug,
    match_views,
)
from vo_service.odometry.surf.recovery import RecoveredPose, SurfRecovery
from vo_service.types.estimate import Estimate, TrackingDebug
from vo_service.types.odometry import NullStageTimer, StageTimer


class SurfOdometry:
    """Frame-to-frame odometry; a frame that fails is skipped.

    The reference is the last good frame. The world frame is the first good camera pose. A frame
    that does not fit the reference is retried by `SurfRecovery` before it fails.

    Args:
        extractor: A default one if None.
        parameters: Default ones if None.
        timer: Times the stages; not timed if None.
        recovery: A default one if None.
    """

    def __init__(
        self,
        extractor: FeatureExtractor | None = None,
        parameters: SurfParameters | None = None,
        timer: StageTimer | None = None,
        recovery: SurfRecovery | None = None,
    ) -> None:
        self._extractor = extractor or SurfExtractor()
        self._parameters = parameters or SurfParameters()
        self._timer = timer or NullStageTimer()
        self._reference: FeatureView | None = None
        self._T_world_reference = np.eye(4)
        self._recovery = recovery or SurfRecovery(self._parameters)
        self._failures = 0

    @property
    def feature_count(self) -> int:
        """Largest number of features per frame; a change applies from the next frame on."""
        return self._extractor.count

    @feature_count.setter
    def feature_count(self, count: int) -> None:
        self._extractor.count = count

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose from this frame and the last good one."""
        with self._timer.stage("surf"):
            features = self._extractor.extract(frame.gray)
        with self._timer.stage("points"):
            points = backproject_features(features, frame)
            depth = DepthGrid.of(frame.depth_m, frame.camera)
        view = FeatureView(features, points, frame.camera, frame.stamp_s, depth)
        if self._reference is None:
            return self._start(view, is_reset=False)
        with self._timer.stage("match"):
            matches = match_views(view, self._reference, self._parameters.match_ratio)
            pairs = pair_points(view.points, self._reference.points, matches)
        parameters = self._parameters
        motion = estimate_motion(pairs, parameters, self._timer)
        debug = make_tracking_debug(view, self._reference, matches, motion.inlier)
        with self._timer.stage("verify"):
            rejection = rejection_reason(
                view, self._reference, motion, LAST_VIEW_VERIFIER, parameters
            )
            motion = motion if rejection else cover_doubt(motion, pairs, parameters)
        if rejection:
            return self._recover(view, self._reference, debug, rejection)
        T_world_camera = self._T_world_reference @ motion.T_reference_camera
        return self._advance(
            view,
            RecoveredPose(T_world_camera, motion.T_reference_camera, motion.covariance, debug),
        )

    def _start(self, view: FeatureView, is_reset: bool) -> Estimate:
        """Make this view the first of a chain, if it has enough points with depth."""
        debug = TrackingDebug(keypoints_px=view.features.position_px)
        if view.points.has_depth.sum() < self._parameters.min_inliers:
            return self._make_estimate(view, _start_failure_reason(view), np.eye(4), debug)
        self._reference = view
        self._recovery.reset(view, self._T_world_reference)
        self._failures = 0
        return self._make_estimate(view, "", np.eye(4), debug, is_reset=is_reset)

    def _recover(
        self, view: FeatureView, last: FeatureView, debug: TrackingDebug, rejection: str
    ) -> Estimate:
        """Try the recovery; without success the frame fails."""
        with self._timer.stage("recovery"):
            recovered = self._recovery.recover(view, last, turn=self._failures)
        if recovered is None:
            return self._fail(view, debug, rejection)
        return self._advance(view, recovered)

    def _fail(self, view: FeatureView, debug: TrackingDebug, rejection: str) -> Estimate:
        """Keep the pose; after too many failures drop the reference and start again."""
        self._failures += 1
        if self._failures > self._parameters.max_failures:
            return self._start(view, is_reset=True)
        return self._make_estimate(view, rejection, np.eye(4), debug)

    def _advance(self, view: FeatureView, recovered: RecoveredPose) -> Estimate:
        """Take over the pose and make the view the next reference."""
        self._recovery.add(
            view, recovered.T_world_camera, recovered.T_last_camera, recovered.covariance
        )
        self._T_world_reference = recovered.T_world_camera
        self._reference = view
        self._failures = 0
        doubt = doubt_reason(recovered.covariance, self._parameters)
        estimate = self._make_estimate(
            view, "", recovered.T_last_camera, recovered.debug, covariance=recovered.covariance
        )
        return replace(estimate, reason=doubt)

    def _make_estimate(
        self,
        view: FeatureView,
        reason: str,
        T_reference_camera: Array,
        debug: TrackingDebug,
        covariance: Array | None = None,
        is_reset: bool = False,
    ) -> Estimate:
        return Estimate(
            ok=not reason,
            reason=reason,
            T_world_camera=self._T_world_reference.copy(),
            T_reference_camera=T_reference_camera,
            covariance=np.zeros((6, 6)) if covariance is None else covariance,
            features=len(view.features),
            matches=len(debug.matches_px),
            inliers=int(debug.inlier.sum()),
            is_reset=is_reset and not reason,
            debug=debug,
        )


def _start_failure_reason(view: FeatureView) -> str:
    """Why a view cannot start a chain."""
    return (
        f"too few features with depth to start: {int(view.points.has_depth.sum())} "
        f"of {len(view.features)}"
    )
