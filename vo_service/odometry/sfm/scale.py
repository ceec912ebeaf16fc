"""Scale, which color alone does not give: of the first two views, and of a motion by known points.

Only for the first motion structure from motion uses depth, and only that of the first frame. For
the others: Nistér, Naroditsky and Bergen, "Visual odometry", CVPR 2004; Scaramuzza and Fraundorfer,
"Visual odometry, part I", IEEE Robotics and Automation Magazine 18 (2011), Section "2-D-to-2-D".
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform
from vo_service.odometry.features.extractor import Features
from vo_service.odometry.features.points import backproject_features
from vo_service.odometry.sfm.essential import UnscaledMotion, triangulate
from vo_service.odometry.sfm.keyframe import (
    MatchedView,
    RegisteredView,
    RegistrationFailure,
    SfmPoints,
    pair_rays,
)
from vo_service.odometry.sfm.mono_frame import RayPairs, ShutterMotion
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.two_view_refinement import TwoViewEstimate, refine_two_view

# Fewest points with depth, and shortest baseline, for a scale.
MIN_POINTS = 15
MIN_BASELINE_M = 1e-3
# Ratios for normal errors: sigma to the median absolute deviation, and sigma of the median to that
# of the mean.
SIGMA_PER_MAD, MEDIAN_SIGMA_PER_MEAN_SIGMA = 1.4826, 1.2533
# Relative sigma of a known baseline.
BASELINE_SIGMA = 0.01


@dataclass(frozen=True)
class InitialPair:
    """The first two views with parallax: their points in units of their motion's length.

    Attributes:
        frame: The first view.
        features: Of the first view.
        stamp_s: Of the second view.
        index: (K,) indices of the triangulated features.
        inverse_depth: (K,) of these in the first view, 1 / length of the motion.
    """

    frame: RgbdFrame
    features: Features
    stamp_s: float
    index: NDArray[np.int64]
    inverse_depth: Array


@dataclass(frozen=True)
class MetricScale:
    """Meters per unit, and the standard deviation of its logarithm."""

    metres_per_unit: float
    log_sigma: float


class ScaleSource(Protocol):
    """Source of the initial scale, used once in each chain of frames."""

    @property
    def name(self) -> str:
        """Name for messages, such as "depth of the first frame"."""
        ...

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """Estimate the length of the first motion; None if it is unknown."""
        ...


class FirstDepthScale:
    """Scale by the depth image of the first frame: the median ratio over the points."""

    name = "depth of the first frame"

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """Estimate the scale; None if fewer than `MIN_POINTS` points have depth."""
        depth_m = backproject_features(pair.features, pair.frame).position_m[pair.index, 2]
        ratio = (depth_m * pair.inverse_depth)[depth_m > 0.0]
        ratio = ratio[ratio > 0.0]
        if len(ratio) < MIN_POINTS:
            return None
        metres_per_unit = float(np.median(ratio))
        return MetricScale(metres_per_unit, median_sigma(np.log(ratio)))


class GivenBaselineScale:
    """Scale by the distance between two frames by their stamps, such as from motion capture."""

    name = "known baseline"

    def __init__(self, distance_m: Callable[[float, float], float]) -> None:
        self._distance_m = distance_m

    def estimate_scale(self, pair: InitialPair) -> MetricScale | None:
        """Estimate the scale; None if the distance is less than `MIN_BASELINE_M`.

        Errors of the given function are passed on.
        """
        distance_m = self._distance_m(pair.frame.stamp_s, pair.stamp_s)
        if not MIN_BASELINE_M < distance_m < np.inf:
            return None
        return MetricScale(distance_m, BASELINE_SIGMA)


def median_sigma(values: Array) -> float:
    """Standard deviation of the median of (N,) values, from their scatter; N is at least 1."""
    deviation = np.abs(values - np.median(values))
    sigma = SIGMA_PER_MAD * float(np.median(deviation))
    return MEDIAN_SIGMA_PER_MEAN_SIGMA * sigma / float(np.sqrt(len(values)))


# Smallest parallax, in standard deviations, of a point that determines the scale.
MIN_PARALLAX_SIGMAS = 3.0
MIN_SHARED_POINTS = 8
ITERATIONS = 6


def propose_scaled_motions(unscaled_motion: UnscaledMotion | None, pairs: RayPairs) -> list[Array]:
    """Propose motions T_camera_reference (4x4) in meters, by each method that works.

    With parallax the essential matrix gives the direction of the motion better than single points
    do. Without it (a short step, a pure rotation) it gives the rotation only.
    """
    if unscaled_motion is None:
        return []
    common = pairs.select(pairs.has_known_depth & unscaled_motion.inlier)
    if len(common) < MIN_SHARED_POINTS:
        return []
    translations = (
        _scale_by_depth_ratio(unscaled_motion, common),
        _solve_translation(unscaled_motion.R, common),
    )
    return [rigid_transform(unscaled_motion.R, t) for t in translations if t is not None]


def _scale_by_depth_ratio(unscaled_motion: UnscaledMotion, common: RayPairs) -> Array | None:
    """The translation with the median length by which the points have their known depths."""
    points = triangulate(unscaled_motion.R, unscaled_motion.t, common)
    has_parallax = points.parallax_rad > MIN_PARALLAX_SIGMAS * common.sigma
    is_used = has_parallax & (points.inverse_depth > 0.0)
    if is_used.sum() < MIN_SHARED_POINTS:
        return None
    length = float(np.median(points.inverse_depth[is_used] / common.inverse_depth[is_used]))
    return unscaled_motion.t * length


def _solve_translation(R: Array, common: RayPairs) -> Array:
    """(3,) translation that moves the known points to their observations, given the rotation.

    It is linear in t, with Cauchy's weights for outliers.
    """
    q = common.ray_reference @ R.T
    moved = common.ray[:, :2] * q[:, 2:] - q[:, :2]
    A = np.zeros((len(common), 2, 3))
    A[:, 0, 0] = A[:, 1, 1] = common.inverse_depth
    A[:, :, 2] = -common.inverse_depth[:, None] * common.ray[:, :2]
    t = np.zeros(3)
    for _ in range(ITERATIONS):
        error = (moved - A @ t) / common.sigma
        w = 1.0 / (1.0 + 0.25 * np.einsum("ni,ni->n", error, error))
        H = np.einsum("nij,n,nik->jk", A, w, A) + 1e-9 * np.eye(3)
        t = np.linalg.solve(H, np.einsum("nij,n,ni->j", A, w, moved))
    return t


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
