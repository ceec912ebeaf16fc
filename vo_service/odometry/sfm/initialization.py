"""Initialization by the first two views: their motion up to scale, and the initial scale."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform
from vo_service.odometry.sfm import SfmParameters
from vo_service.odometry.sfm.essential import UnscaledMotion, triangulate
from vo_service.odometry.sfm.keyframe import SfmPoints, pair_rays
from vo_service.odometry.sfm.mono_frame import RayPairs, ShutterMotion
from vo_service.odometry.sfm.registered_view import MatchedView, RegisteredView, RegistrationFailure
from vo_service.odometry.sfm.scale import InitialPair, ScaleSource
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate, refine_two_view


@dataclass(frozen=True)
class InitialRegistration:
    """The second view, registered in meters, and the sigma of the scale's logarithm."""

    registered: RegisteredView
    scale_sigma: float


class SfmInitializer:
    """Initialization of the scale by a second view with enough parallax."""

    def __init__(self, parameters: SfmParameters, source: ScaleSource) -> None:
        self._parameters = parameters
        self._source = source
        self._frame: RgbdFrame | None = None

    def reset(self, frame: RgbdFrame) -> None:
        """Start with the first frame of a chain."""
        self._frame = frame

    def initialize(self, matched_view: MatchedView) -> InitialRegistration | RegistrationFailure:
        """Register the second view against the keyframe, which is the first view.

        The failure is `is_waiting` until there is enough parallax.
        """
        unscaled, min_inliers = matched_view.unscaled_motion, self._parameters.min_initial_inliers
        num_agreeing = 0 if unscaled is None else int(unscaled.inlier.sum())
        if self._frame is None or unscaled is None or num_agreeing < min_inliers:
            return RegistrationFailure(
                matched_view, f"only {num_agreeing} of {len(matched_view.matches)} matches agree"
            )
        parallax = median_parallax_rad(unscaled, matched_view.pairs)
        if parallax < self._parameters.min_initial_parallax_rad:
            return RegistrationFailure(
                matched_view, self._parallax_reason(parallax), is_waiting=True
            )
        matched_view = compensate_pair(
            matched_view, refine_unscaled_motion(unscaled, matched_view.pairs)
        )
        refined = refine_unscaled_motion(unscaled, matched_view.pairs)
        if refined.inlier.sum() < min_inliers:
            return RegistrationFailure(
                matched_view,
                f"only {refined.inlier.sum()} of {len(matched_view.matches)} points agree",
            )
        scale = self._source.estimate_scale(_make_initial_pair(self._frame, matched_view, refined))
        if scale is None:
            return RegistrationFailure(
                matched_view, f"no initial scale from the {self._source.name}"
            )
        self._frame = None
        return InitialRegistration(
            RegisteredView(matched_view, apply_scale(refined, scale.metres_per_unit)),
            scale.log_sigma,
        )

    def _parallax_reason(self, parallax: float) -> str:
        now_deg, needed_deg = np.degrees([parallax, self._parameters.min_initial_parallax_rad])
        return f"waiting for parallax ({now_deg:.1f} of {needed_deg:.1f} degrees): move sideways"


def _make_initial_pair(
    frame: RgbdFrame, matched_view: MatchedView, two_view: TwoViewEstimate
) -> InitialPair:
    return InitialPair(
        frame=frame,
        features=matched_view.keyframe.view.features,
        stamp_s=matched_view.view.stamp_s,
        index=matched_view.matches[two_view.inlier, 1],
        inverse_depth=two_view.inverse_depth[two_view.inlier],
    )


def compensate_pair(matched_view: MatchedView, two_view: TwoViewEstimate) -> MatchedView:
    """Compensate the rolling shutter in both views, for a constant velocity between them."""
    T_first_second = inverse(two_view.T_camera_reference)
    first = matched_view.keyframe.view
    duration_s = matched_view.view.stamp_s - first.stamp_s
    inverse_depth = float(np.median(two_view.inverse_depth))
    view = matched_view.view.compensate_rolling_shutter(
        ShutterMotion.from_motion(T_first_second, duration_s, inverse_depth)
    )
    reverse_motion = ShutterMotion.from_motion(inverse(T_first_second), -duration_s, inverse_depth)
    keyframe = replace(matched_view.keyframe, view=first.compensate_rolling_shutter(reverse_motion))
    pairs = pair_rays(view, keyframe, SfmPoints.empty(), matched_view.matches)
    return replace(matched_view, view=view, keyframe=keyframe, pairs=pairs)


def median_parallax_rad(unscaled_motion: UnscaledMotion, pairs: RayPairs) -> float:
    """Median parallax of the pairs that agree; 0 without any."""
    inlier_pairs = pairs.select(unscaled_motion.inlier)
    points = triangulate(unscaled_motion.R, unscaled_motion.t, inlier_pairs)
    return float(np.median(points.parallax_rad)) if len(inlier_pairs) else 0.0


def refine_unscaled_motion(unscaled_motion: UnscaledMotion, pairs: RayPairs) -> TwoViewEstimate:
    """Refine a motion of length 1, and its points in that unit, by the reprojection error."""
    refined = refine_two_view(rigid_transform(unscaled_motion.R, unscaled_motion.t), pairs)
    length = float(np.linalg.norm(refined.T_camera_reference[:3, 3]))
    return apply_scale(refined, 1.0 / max(length, 1e-9))


def apply_scale(two_view: TwoViewEstimate, metres_per_unit: float) -> TwoViewEstimate:
    """Scale a motion and its points to meters. The covariance takes the length as exact."""
    T = two_view.T_camera_reference
    t_m = metres_per_unit * T[:3, 3]
    direction = t_m / max(float(np.linalg.norm(t_m)), 1e-12)
    units = np.eye(6)
    units[:3, :3] = metres_per_unit * (np.eye(3) - np.outer(direction, direction))
    covariance: Array = units @ two_view.covariance @ units.T
    return replace(
        two_view,
        T_camera_reference=rigid_transform(T[:3, :3], t_m),
        inverse_depth=two_view.inverse_depth / metres_per_unit,
        information=two_view.information * metres_per_unit**2,
        covariance=covariance,
    )
