"""Structure from motion: odometry by color only, except for the initial scale.

Nistér, Naroditsky and Bergen, "Visual odometry", CVPR 2004; Scaramuzza and Fraundorfer, "Visual
odometry, part I", IEEE Robotics and Automation Magazine 18 (2011), whose steps these are.
"""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.odometry.features.extractor import FeatureExtractor, SurfExtractor
from vo_service.odometry.features.match_verifier import MatchVerifier
from vo_service.odometry.features.matching import match_features
from vo_service.odometry.sfm.essential import find_unscaled_motion
from vo_service.odometry.sfm.keyframe import (
    MatchedView,
    RegisteredView,
    RegistrationFailure,
    SfmKeyframe,
)
from vo_service.odometry.sfm.mono_frame import MonoFrame
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.scale import (
    FirstDepthScale,
    ScaleSource,
    SfmInitializer,
    propose_scaled_motions,
)
from vo_service.odometry.sfm.trajectory_state import TrajectoryState, TrajectoryStep
from vo_service.odometry.sfm.two_view_refinement import refine_best_guess, refine_two_view
from vo_service.types.estimate import Estimate, TrackingDebug
from vo_service.types.odometry import NullStageTimer, StageTimer

# Known points agree within a few pixels of their projections: few do so by chance.
KNOWN_POINTS_VERIFIER = MatchVerifier(inlier_share_if_right=0.5, inlier_share_by_chance=0.05)


class SfmOdometry:
    """Odometry by color only, against keyframes; a frame that fails is skipped.

    The world frame is the first camera pose. There is no pose until the camera has moved far enough
    from the start. Then `scale_source` gives the scale, and common points propagate it. After a
    loss the scale is lost, and the source is used again.

    Args:
        extractor: A default one if None.
        parameters: Default ones if None.
        timer: Times the stages; not timed if None.
        scale_source: `FirstDepthScale` if None.
    """

    def __init__(
        self,
        extractor: FeatureExtractor | None = None,
        parameters: SfmParameters | None = None,
        timer: StageTimer | None = None,
        scale_source: ScaleSource | None = None,
    ) -> None:
        self._extractor = extractor or SurfExtractor()
        self._parameters = parameters or SfmParameters()
        self._timer = timer or NullStageTimer()
        self._initializer = SfmInitializer(self._parameters, scale_source or FirstDepthScale())
        self._trajectory = TrajectoryState(self._parameters)
        self._failures = 0

    @property
    def feature_count(self) -> int:
        """Largest number of features per frame; a change applies from the next frame on."""
        return self._extractor.count

    @feature_count.setter
    def feature_count(self, count: int) -> None:
        self._extractor.count = count

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose from this frame and the keyframes."""
        with self._timer.stage("surf"):
            view = MonoFrame.from_features(self._extractor.extract(frame.gray), frame)
            view = self._trajectory.predict_view(view)
        keyframes = self._trajectory.window.keyframes
        if not keyframes:
            return self._start(view, frame, is_reset=False)
        matched_view = self._match_view(view, keyframes[0])
        if not self._trajectory.has_scale:
            return self._initialize_scale(matched_view, frame)
        registered = self._register(matched_view)
        if isinstance(registered, RegistrationFailure):
            registered = self._recover(registered)
        if isinstance(registered, RegistrationFailure):
            return self._fail(registered, frame)
        # With a rolling shutter, refined by the velocity that is known now.
        with self._timer.stage("refine"):
            registered = self._refine_rolling_shutter(registered)
        with self._timer.stage("points"):
            step = self._trajectory.add(registered)
        return self._succeed(registered, step)

    def _match_view(self, view: MonoFrame, keyframe: SfmKeyframe) -> MatchedView:
        """Match a view with a keyframe and estimate their motion up to scale."""
        with self._timer.stage("match"):
            ratio = self._parameters.match_ratio
            matches = match_features(view.features, keyframe.view.features, ratio)
            pairs = self._trajectory.window.pair_rays(view, keyframe, matches)
        with self._timer.stage("ransac"):
            direction = find_unscaled_motion(pairs, self._parameters.seed)
        return MatchedView(view, keyframe, matches, pairs, direction)

    def _register(self, matched_view: MatchedView) -> RegisteredView | RegistrationFailure:
        """Register a matched view in meters by the known points."""
        common = int(matched_view.pairs.has_known_depth.sum())
        if common < self._parameters.min_inliers:
            return RegistrationFailure(
                matched_view,
                f"only {common} of {len(matched_view.matches)} matches are known points",
            )
        with self._timer.stage("scale"):
            guesses = propose_scaled_motions(matched_view.unscaled_motion, matched_view.pairs)
        with self._timer.stage("refine"):
            guesses.append(self._trajectory.initial_guess(matched_view.keyframe))
            registered = RegisteredView(
                matched_view, refine_best_guess(guesses, matched_view.pairs)
            )
        agree = registered.num_known_inliers
        if agree < self._parameters.min_inliers or not KNOWN_POINTS_VERIFIER.accepts(agree, common):
            return RegistrationFailure(matched_view, f"only {agree} of {common} known points agree")
        if self._trajectory.is_too_fast(registered):
            return RegistrationFailure(
                matched_view, f"the step is too long for a camera ({agree} points agree)"
            )
        if registered.max_sigma_rad > self._parameters.max_sigma_rad:
            return RegistrationFailure(
                matched_view, f"the motion is too uncertain ({agree} points agree)"
            )
        return registered

    def _refine_rolling_shutter(self, registered: RegisteredView) -> RegisteredView:
        """Register the view again, each row at its own time."""
        matched_view = registered.matched_view
        if not matched_view.view.has_rolling_shutter:
            return registered
        view = matched_view.view.compensate_rolling_shutter(
            self._trajectory.estimate_shutter_motion(registered)
        )
        pairs = self._trajectory.window.pair_rays(view, matched_view.keyframe, matched_view.matches)
        refined = refine_two_view(registered.two_view.T_camera_reference, pairs)
        candidate = RegisteredView(replace(matched_view, view=view, pairs=pairs), refined)
        return min(registered, candidate, key=lambda each: each.two_view.cost)

    def _initialize_scale(self, matched_view: MatchedView, frame: RgbdFrame) -> Estimate:
        """Initialize the scale by a second view with parallax to the first."""
        with self._timer.stage("scale"):
            initial = self._initializer.initialize(matched_view)
        if isinstance(initial, RegistrationFailure):
            return self._fail(initial, frame)
        with self._timer.stage("points"):
            step = self._trajectory.initialize(initial.registered, initial.scale_sigma)
        return self._succeed(initial.registered, step)

    def _recover(self, failure: RegistrationFailure) -> RegisteredView | RegistrationFailure:
        """Try the last good frame if it is no keyframe, then one of the older keyframes in turn."""
        view = failure.matched_view.view
        if self._trajectory.promote_last_frame():
            registered = self._register(
                self._match_view(view, self._trajectory.window.keyframes[0])
            )
            if isinstance(registered, RegisteredView):
                return registered
        older = self._trajectory.window.keyframes[1:]
        if not older:
            return failure
        registered = self._register(self._match_view(view, older[self._failures % len(older)]))
        return registered if isinstance(registered, RegisteredView) else failure

    def _start(self, view: MonoFrame, frame: RgbdFrame, is_reset: bool) -> Estimate:
        """Make this view the first of a chain, if it has enough features."""
        debug = TrackingDebug(keypoints_px=view.features.position_px)
        min_features = self._parameters.min_initial_inliers
        if len(view.features) < min_features:
            return self._report_failure(f"too few features to start: {len(view.features)}", debug)
        self._trajectory.reset(view)
        self._initializer.reset(frame)
        self._failures = 0
        return self._make_estimate("", TrajectoryStep(np.eye(4), np.zeros((6, 6))), debug, is_reset)

    def _succeed(self, registered: RegisteredView, step: TrajectoryStep) -> Estimate:
        self._failures = 0
        return self._make_estimate(
            "", step, registered.matched_view.make_tracking_debug(registered.two_view.inlier)
        )

    def _fail(self, failure: RegistrationFailure, frame: RgbdFrame) -> Estimate:
        """Keep the pose; after too many failures start again with this view."""
        self._failures = 0 if failure.is_waiting else self._failures + 1
        if self._failures > self._parameters.max_failures:
            return self._start(failure.matched_view.view, frame, is_reset=True)
        no_inlier = np.zeros(len(failure.matched_view.matches), np.bool_)
        return self._report_failure(
            failure.reason, failure.matched_view.make_tracking_debug(no_inlier)
        )

    def _report_failure(self, reason: str, debug: TrackingDebug) -> Estimate:
        return self._make_estimate(reason, TrajectoryStep(np.eye(4), np.zeros((6, 6))), debug)

    def _make_estimate(
        self, reason: str, step: TrajectoryStep, debug: TrackingDebug, is_reset: bool = False
    ) -> Estimate:
        return Estimate(
            ok=not reason,
            reason=reason,
            T_world_camera=self._trajectory.T_world_last.copy(),
            T_reference_camera=step.T_last_camera,
            covariance=step.covariance,
            features=len(debug.keypoints_px),
            matches=len(debug.matches_px),
            inliers=int(debug.inlier.sum()),
            is_reset=is_reset,
            debug=debug,
        )
