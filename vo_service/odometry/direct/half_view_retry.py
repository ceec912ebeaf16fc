"""Retry with half of the view masked, where the motion is unexpected: it may follow an object.

A near object with much texture can be followed by a rotation: distant surfaces hardly move, and
nearly all of the view fits. So each half of the view is masked in turn. If the object is in the
masked half, the motion is that of the room.
"""

from dataclasses import replace
from math import log

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct import residual_stats
from vo_service.odometry.direct.alignment import DirectAlignment, align, uniform_weights
from vo_service.odometry.direct.grid import CELL_COLUMNS, CELL_ROWS
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.normal_equations import SIGMA_BRIGHTNESS
from vo_service.odometry.direct.parameters import (
    INNOVATION_COST_WEIGHT,
    INNOVATION_DEGREES_OF_FREEDOM,
    INNOVATION_GATE_SIGMAS,
    MIN_STATIC_WEIGHT,
    NUM_FINE_LEVELS,
)
from vo_service.odometry.direct.quality import rejection_reason
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.region_weights import weigh_regions

# Columns of cells that are masked: the left, middle and right half of the view.
MASKED_COLUMNS = (slice(0, 4), slice(2, 6), slice(4, 8))


def retry_without_half(
    result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> TrackingResult:
    """Return the result, or that of a half masked view if it has the lowest cost.

    The cost grows with the residuals of the whole view and with the innovation.
    """
    if (
        motion_state.innovation_ratio(result.alignment.camera_velocity, images.stamp_s)
        < INNOVATION_GATE_SIGMAS
    ):
        return result
    retries = [_align_without(half, result, images, motion_state) for half in MASKED_COLUMNS]
    candidates = [result.alignment, *(each for each in retries if not rejection_reason(each))]
    sigmas = np.min([each.residual_model for each in candidates], axis=0)[SIGMA_BRIGHTNESS:]
    points = result.keyframe.points[0]

    def cost(candidate: DirectAlignment) -> float:
        innovation = motion_state.innovation_ratio(candidate.camera_velocity, images.stamp_s)
        return _mean_cost(points, candidate, sigmas) + INNOVATION_COST_WEIGHT * log(
            1 + innovation**2 / INNOVATION_DEGREES_OF_FREEDOM
        )

    return replace(result, alignment=min(candidates, key=cost))


def _align_without(
    masked_columns: slice, result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> DirectAlignment:
    """Align with half of the view, then with all regions that fit this motion."""
    points, prior = result.keyframe.points, result.prior
    weights = uniform_weights()
    weights.reshape(2, CELL_ROWS, CELL_COLUMNS)[:, :, masked_columns] = 0.0
    expected = motion_state.initial_guesses(result.keyframe.T_world_keyframe, images.stamp_s)[:1]
    partial = align(
        points, images, expected, prior, motion_state.predict_affine_brightness(images), weights
    )
    region_weights = weigh_regions(
        points[0], partial.samples, partial.residual_model, uniform_weights()
    )
    static_weights = (region_weights >= MIN_STATIC_WEIGHT).astype(np.float64)
    return align(
        points[:NUM_FINE_LEVELS],
        images,
        [partial.T_camera_keyframe],
        prior,
        partial.affine_brightness,
        static_weights,
    )


def _mean_cost(points: Array, alignment: DirectAlignment, sigmas: Array) -> float:
    """Mean robust cost of a sample in the whole view, for given sigmas (2,)."""
    residual_model = alignment.residual_model.copy()
    residual_model[SIGMA_BRIGHTNESS:] = sigmas
    counts = residual_stats.count_residuals(
        points, alignment.samples, residual_model, uniform_weights()
    )
    sampled = counts[residual_stats.WITH_DEPTH] + counts[residual_stats.WITH_BRIGHTNESS]
    return float(counts[residual_stats.COST] / max(sampled, 1.0))
