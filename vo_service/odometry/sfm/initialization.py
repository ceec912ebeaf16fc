"""The first two views: a motion whose length is not known, and what gives it one."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform
from vo_service.odometry.sfm.essential import UnscaledMotion
from vo_service.odometry.sfm.keyframe import SfmPoints, pair_rays
from vo_service.odometry.sfm.mono_frame import RayPairs
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.registered_view import MatchedView, RegisteredView, RegistrationFailure
from vo_service.odometry.sfm.rolling_shutter import ShutterMotion
from vo_service.odometry.sfm.scale_source import InitialPair, ScaleSource
from vo_service.odometry.sfm.triangulation import triangulate
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate, refine_two_view


@dataclass(frozen=True)
class InitialRegistration:
    """The second view, placed in metres; sigma of the scale's logarithm."""

    registered: RegisteredView
    scale_sigma: float


class SfmInitializer:
    """Waits for a second view with enough parallax."""

    def __init__(self, parameters: SfmParameters, source: ScaleSource) -> None:
        self._parameters = parameters
        self._source = source
        self._frame: RgbdFrame | None = None

    def reset(self, frame: RgbdFrame) -> None:
        """The first frame of a chain."""
        self._frame = frame

    def initialize(self, matched_view: MatchedView) -> InitialRegistration | RegistrationFailure:
        """The second view of a sight whose keyframe is the first."""
        direction, fewest = matched_view.unscaled_motion, self._parameters.min_initial_inliers
        agreeing = 0 if direction is None else int(direction.inlier.sum())
        if self._frame is None or direction is None or agreeing < fewest:
            return RegistrationFailure(
                matched_view, f"{agreeing} of {len(matched_view.matches)} matches agree"
            )
        parallax = median_parallax_rad(direction, matched_view.pairs)
        if parallax < self._parameters.min_initial_parallax_rad:
            return RegistrationFailure(
                matched_view, self._parallax_reason(parallax), is_waiting=True
            )
        matched_view = compensate_pair(
            matched_view, refine_unscaled_motion(direction, matched_view.pairs)
        )
        refined = refine_unscaled_motion(direction, matched_view.pairs)
        if refined.inlier.sum() < fewest:
            return RegistrationFailure(
                matched_view, f"{refined.inlier.sum()} of {len(matched_view.matches)} points agree"
            )
        scale = self._source.estimate_scale(_make_initial_pair(self._frame, matched_view, refined))
        if scale is None:
            return RegistrationFailure(matched_view, f"no first scale from the {self._source.name}")
        self._frame = None
        return InitialRegistration(
            RegisteredView(matched_view, apply_scale(refined, scale.metres_per_unit)),
            scale.log_sigma,
        )

    def _parallax_reason(self, parallax: float) -> str:
        now_deg, needed_deg = np.degrees([parallax, self._parameters.min_initial_parallax_rad])
        return f"waiting for parallax, {now_deg:.1f} of {needed_deg:.1f} degrees: move sideways"


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
    """The same sight, of a shutter that rolls, if the camera went steadily from view to view."""
    T_first_second = inverse(two_view.T_camera_reference)
    first = matched_view.keyframe.view
    duration_s = matched_view.view.stamp_s - first.stamp_s
    inverse_depth = float(np.median(two_view.inverse_depth))
    view = matched_view.view.compensate_rolling_shutter(
        ShutterMotion.from_motion(T_first_second, duration_s, inverse_depth)
    )
    backwards = ShutterMotion.from_motion(inverse(T_first_second), -duration_s, inverse_depth)
    keyframe = replace(matched_view.keyframe, view=first.compensate_rolling_shutter(backwards))
    pairs = pair_rays(view, keyframe, SfmPoints.empty(), matched_view.matches)
    return replace(matched_view, view=view, keyframe=keyframe, pairs=pairs)


def median_parallax_rad(unscaled_motion: UnscaledMotion, pairs: RayPairs) -> float:
    """The median over the pairs that agree; 0 of none."""
    seen = pairs.select(unscaled_motion.inlier)
    found = triangulate(unscaled_motion.R, unscaled_motion.t, seen).parallax_rad
    return float(np.median(found)) if len(found) else 0.0


def refine_unscaled_motion(unscaled_motion: UnscaledMotion, pairs: RayPairs) -> TwoViewEstimate:
    """A motion of length 1, and points in that unit, by the least reprojection error."""
    refined = refine_two_view(rigid_transform(unscaled_motion.R, unscaled_motion.t), pairs)
    length = float(np.linalg.norm(refined.T_camera_reference[:3, 3]))
    return apply_scale(refined, 1.0 / max(length, 1e-9))


def apply_scale(two_view: TwoViewEstimate, metres_per_unit: float) -> TwoViewEstimate:
    """The same in metres. The covariance is that of all but the length, which counts as exact."""
    T = two_view.T_camera_reference
    t_m = metres_per_unit * T[:3, 3]
    along = t_m / max(float(np.linalg.norm(t_m)), 1e-12)
    units = np.eye(6)
    units[:3, :3] = metres_per_unit * (np.eye(3) - np.outer(along, along))
    covariance: Array = units @ two_view.covariance @ units.T
    return replace(
        two_view,
        T_camera_reference=rigid_transform(T[:3, :3], t_m),
        inverse_depth=two_view.inverse_depth / metres_per_unit,
        information=two_view.information * metres_per_unit**2,
        covariance=covariance,
    )
