"""Whether to believe an alignment."""

from math import sqrt

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct import residual_stats
from vo_service.odometry.direct.alignment import DirectAlignment
from vo_service.odometry.direct.derived_parameters import (
    GAIN_RANGE,
    MAX_VALID_SIGMAS,
    MIN_CONSISTENT_SHARE,
    SUSPECT_SIGMAS,
)
from vo_service.odometry.direct.normal_equations import GAIN, SIGMA_BRIGHTNESS, SIGMA_DEPTH
from vo_service.odometry.direct.parameters import HALF, LITTLE, MIN_POINTS, SLIGHT
from vo_service.odometry.direct.warping import OCCLUDED, SAMPLE_OCCLUSION


def is_consistent(counts: Array) -> bool:
    """Whether most of what is seen of a keyframe agrees with it."""
    return not _inconsistency_reason(counts)


def _inconsistency_reason(counts: Array) -> str:
    """What does not agree with a keyframe; "" if both do."""
    for what, agreeing, read in (
        ("depths", counts[residual_stats.DEPTH_AGREES], counts[residual_stats.WITH_DEPTH]),
        (
            "brightnesses",
            counts[residual_stats.BRIGHTNESS_AGREES],
            counts[residual_stats.WITH_BRIGHTNESS],
        ),
    ):
        if agreeing < MIN_CONSISTENT_SHARE * read:
            return f"{agreeing:.0f} of {read:.0f} {what} agree with the keyframe's"
    return ""


def outlier_score(alignment: DirectAlignment) -> float:
    """How badly a keyframe fits: above 1 there may be a better motion."""
    seen = max(alignment.counts[residual_stats.IN_IMAGE], 1.0)
    return float(
        max(
            _normalized_sigma(alignment),
            alignment.counts[residual_stats.DISREGARDED] / seen / SLIGHT,
        )
    )


def _normalized_sigma(alignment: DirectAlignment) -> float:
    """The spreads of what fits: above 1 either is odd."""
    by_depth = float(alignment.residual_model[SIGMA_DEPTH] / SUSPECT_SIGMAS[1])
    if not alignment.uses_brightness:
        return by_depth
    return max(by_depth, float(alignment.residual_model[SIGMA_BRIGHTNESS] / SUSPECT_SIGMAS[0]))


def residual_score(alignment: DirectAlignment) -> float:
    """What two motions are compared by: the spreads of what fits, over its share of the view.

    `oddness` would not do: regions that do not fit are those that fit worse than most of the view
    does, so that there are none where all of it fits badly.
    """
    counts = alignment.counts
    share = 1.0 - counts[residual_stats.DISREGARDED] / max(counts[residual_stats.IN_IMAGE], 1.0)
    spread = alignment.residual_model[SIGMA_DEPTH] / SUSPECT_SIGMAS[1]
    if alignment.uses_brightness:
        spread = sqrt(spread * alignment.residual_model[SIGMA_BRIGHTNESS] / SUSPECT_SIGMAS[0])
    return float(spread / max(share, 0.01))


def rejection_reason(alignment: DirectAlignment) -> str:
    """Why an alignment is not to be believed; "" if it is."""
    counts, fit, points = alignment.counts, alignment.residual_model, len(alignment.samples)
    seen = int(counts[residual_stats.IN_IMAGE])
    if seen < max(LITTLE * points, MIN_POINTS):
        return f"{seen} of {points} points of the keyframe are in view"
    if counts[residual_stats.DISREGARDED] > HALF * seen:
        return f"{100 * counts[residual_stats.DISREGARDED] / seen:.0f} % of the view does not fit"
    read = int(counts[residual_stats.WITH_DEPTH] + counts[residual_stats.WITH_BRIGHTNESS])
    if read < MIN_POINTS:
        return f"only {read} readings of what is in view"
    if reason := _inconsistency_reason(counts):
        return reason
    if fit[SIGMA_DEPTH] > MAX_VALID_SIGMAS[1]:
        return "the depth does not fit the keyframe's"
    if alignment.uses_brightness and fit[SIGMA_BRIGHTNESS] > MAX_VALID_SIGMAS[0]:
        return "the brightness does not fit the keyframe's"
    if alignment.uses_brightness and not GAIN_RANGE[0] < fit[GAIN] < GAIN_RANGE[1]:
        return "the light is quite another than the keyframe's"
    return ""


def strict_rejection_reason(alignment: DirectAlignment) -> str:
    """The same where the camera may be anywhere by now: there something always fits somehow."""
    if reason := rejection_reason(alignment):
        return reason
    return (
        "it may be another place: the keyframe fits badly"
        if _normalized_sigma(alignment) > 1.0
        else ""
    )


def occluded_fraction(alignment: DirectAlignment) -> float:
    """Share of the view in which something stands in front of what the keyframe has seen."""
    count = np.count_nonzero(alignment.samples[:, SAMPLE_OCCLUSION] == OCCLUDED)
    return float(count / max(count + alignment.counts[residual_stats.IN_IMAGE], 1.0))


def occlusion_reason(alignment: DirectAlignment) -> str:
    """Why an alignment that fits may be that of a thing in front of the room; "" if it is not."""
    moving = alignment.counts[residual_stats.DISREGARDED] / max(
        alignment.counts[residual_stats.IN_IMAGE], 1.0
    )
    share = 1.0 - (1.0 - occluded_fraction(alignment)) * (1.0 - moving)
    return _occlusion_message(share) if share > HALF else ""


def degradation_reason(alignment: DirectAlignment) -> str:
    """What an alignment has to do without; "" if both have a say in nearly all of the view."""
    counts = alignment.counts
    enough = SLIGHT * counts[residual_stats.IN_IMAGE]
    if counts[residual_stats.WITH_BRIGHTNESS] < enough:
        return "by depth alone: no texture in view"
    if counts[residual_stats.WITH_DEPTH] < enough:
        return "by brightness alone: no depth in view"
    return (
        _occlusion_message(occluded_fraction(alignment))
        if occluded_fraction(alignment) > LITTLE
        else ""
    )


def _occlusion_message(share: float) -> str:
    return f"{100 * share:.0f} % of the view is covered"
