"""Validity of an alignment: scores, and reasons to reject it."""

from math import sqrt

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct import residual_stats
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.image_pyramid import GAIN_RANGE
from vo_service.odometry.direct.normal_equations import GAIN, SIGMA_BRIGHTNESS, SIGMA_DEPTH
from vo_service.odometry.direct.parameters import (
    INITIAL_SIGMAS,
    MAX_MOVING_OR_OCCLUDED_SHARE,
    MAX_MOVING_SHARE,
    MAX_UNDEGRADED_OCCLUDED_SHARE,
    MAX_VALID_SIGMA_RATIO,
    MIN_CONSISTENT_SHARE,
    MIN_IN_VIEW_SHARE,
    MIN_MODALITY_SHARE,
    MIN_POINTS_IN_VIEW,
    MIN_SAMPLES,
    MIN_SCORED_STATIC_SHARE,
    SUSPECT_SIGMA_RATIO,
)
from vo_service.odometry.direct.warping import OCCLUDED, SAMPLE_OCCLUSION

# Bounds of the sigmas of brightness (gray levels) and of depth (1/m): above the first pair a better
# motion is searched for; above the second the motion is wrong.
SUSPECT_SIGMAS = (SUSPECT_SIGMA_RATIO * INITIAL_SIGMAS[0], SUSPECT_SIGMA_RATIO * INITIAL_SIGMAS[1])
MAX_VALID_SIGMAS = (
    MAX_VALID_SIGMA_RATIO * INITIAL_SIGMAS[0],
    MAX_VALID_SIGMA_RATIO * INITIAL_SIGMAS[1],
)


def is_consistent(counts: Array) -> bool:
    """Whether most depth and brightness samples agree with the keyframe, by the counts (7,)."""
    return not _inconsistency_reason(counts)


def _inconsistency_reason(counts: Array) -> str:
    """Which kind of samples does not agree with the keyframe; "" if both do."""
    for what, agreeing, total in (
        ("depth samples", counts[residual_stats.DEPTH_AGREES], counts[residual_stats.WITH_DEPTH]),
        (
            "brightness samples",
            counts[residual_stats.BRIGHTNESS_AGREES],
            counts[residual_stats.WITH_BRIGHTNESS],
        ),
    ):
        if agreeing < MIN_CONSISTENT_SHARE * total:
            return f"only {agreeing:.0f} of {total:.0f} {what} agree with the keyframe"
    return ""


def outlier_score(alignment: DirectAlignment) -> float:
    """Misfit of the keyframe: above 1 there may be a better motion."""
    in_view = max(alignment.counts[residual_stats.IN_IMAGE], 1.0)
    return float(
        max(
            _normalized_sigma(alignment),
            alignment.counts[residual_stats.DISREGARDED] / in_view / MAX_MOVING_SHARE,
        )
    )


def _normalized_sigma(alignment: DirectAlignment) -> float:
    """Larger one of the two sigmas, relative to the suspect ones."""
    by_depth = float(alignment.residual_model[SIGMA_DEPTH] / SUSPECT_SIGMAS[1])
    if not alignment.uses_brightness:
        return by_depth
    return max(by_depth, float(alignment.residual_model[SIGMA_BRIGHTNESS] / SUSPECT_SIGMAS[0]))


def residual_score(alignment: DirectAlignment) -> float:
    """Score by which two motions are compared; lower is better.

    It is the sigma of the static regions over their share of the view. `outlier_score` does not
    suit: moving regions fit worse than most of the view, so there are none if all of it fits badly.
    """
    counts = alignment.counts
    static_share = 1.0 - counts[residual_stats.DISREGARDED] / max(
        counts[residual_stats.IN_IMAGE], 1.0
    )
    sigma = alignment.residual_model[SIGMA_DEPTH] / SUSPECT_SIGMAS[1]
    if alignment.uses_brightness:
        sigma = sqrt(sigma * alignment.residual_model[SIGMA_BRIGHTNESS] / SUSPECT_SIGMAS[0])
    return float(sigma / max(static_share, MIN_SCORED_STATIC_SHARE))


def rejection_reason(alignment: DirectAlignment) -> str:
    """Why an alignment is rejected; "" if it is valid."""
    counts, model, points = alignment.counts, alignment.residual_model, len(alignment.samples)
    in_view = int(counts[residual_stats.IN_IMAGE])
    if in_view < max(MIN_IN_VIEW_SHARE * points, MIN_POINTS_IN_VIEW):
        return f"only {in_view} of {points} points of the keyframe are in view"
    if counts[residual_stats.DISREGARDED] > MAX_MOVING_OR_OCCLUDED_SHARE * in_view:
        return (
            f"{100 * counts[residual_stats.DISREGARDED] / in_view:.0f} % of the view does not fit"
        )
    sampled = int(counts[residual_stats.WITH_DEPTH] + counts[residual_stats.WITH_BRIGHTNESS])
    if sampled < MIN_SAMPLES:
        return f"only {sampled} samples in view"
    if reason := _inconsistency_reason(counts):
        return reason
    if model[SIGMA_DEPTH] > MAX_VALID_SIGMAS[1]:
        return "the depth does not fit the keyframe"
    if alignment.uses_brightness and model[SIGMA_BRIGHTNESS] > MAX_VALID_SIGMAS[0]:
        return "the brightness does not fit the keyframe"
    if alignment.uses_brightness and not GAIN_RANGE[0] < model[GAIN] < GAIN_RANGE[1]:
        return "the brightness changed too much against the keyframe"
    return ""


def strict_rejection_reason(alignment: DirectAlignment) -> str:
    """Why an alignment is rejected where the camera may be anywhere; "" if it is valid."""
    if reason := rejection_reason(alignment):
        return reason
    return (
        "the keyframe fits badly: the camera may be elsewhere"
        if _normalized_sigma(alignment) > 1.0
        else ""
    )


def occluded_fraction(alignment: DirectAlignment) -> float:
    """Share of the view in which something occludes the keyframe's points."""
    count = np.count_nonzero(alignment.samples[:, SAMPLE_OCCLUSION] == OCCLUDED)
    return float(count / max(count + alignment.counts[residual_stats.IN_IMAGE], 1.0))


def occlusion_reason(alignment: DirectAlignment) -> str:
    """Why a good fit may be that of an object in front of the room; "" if it is not."""
    moving = alignment.counts[residual_stats.DISREGARDED] / max(
        alignment.counts[residual_stats.IN_IMAGE], 1.0
    )
    share = 1.0 - (1.0 - occluded_fraction(alignment)) * (1.0 - moving)
    return _occlusion_message(share) if share > MAX_MOVING_OR_OCCLUDED_SHARE else ""


def degradation_reason(alignment: DirectAlignment) -> str:
    """What an alignment lacks; "" if depth and brightness constrain nearly all of the view."""
    counts = alignment.counts
    enough = MIN_MODALITY_SHARE * counts[residual_stats.IN_IMAGE]
    if counts[residual_stats.WITH_BRIGHTNESS] < enough:
        return "depth only: no texture in view"
    if counts[residual_stats.WITH_DEPTH] < enough:
        return "brightness only: no depth in view"
    return (
        _occlusion_message(occluded_fraction(alignment))
        if occluded_fraction(alignment) > MAX_UNDEGRADED_OCCLUDED_SHARE
        else ""
    )


def _occlusion_message(share: float) -> str:
    return f"{100 * share:.0f} % of the view is occluded"
