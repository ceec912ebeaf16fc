"""A second look where the camera seems to have been jolted: its motion may follow a thing.

A thing that is near and has much texture can be followed by turning against it: what is far stays
where it was, and nearly all of the view fits. So each half of the view is left out in turn. What is
left then has the say, and the motion that is found is that of the room if the thing is in the other
half.
"""

from dataclasses import replace
from math import log

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct import residual_stats
from vo_service.odometry.direct.alignment import DirectAlignment, align, uniform_weights
from vo_service.odometry.direct.grid import CELL_COLUMNS, CELL_ROWS
from vo_service.odometry.direct.image_pyramid import NUM_FINE_LEVELS, ImagePyramid
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.normal_equations import SIGMA_BRIGHTNESS
from vo_service.odometry.direct.parameters import DEGREES_OF_FREEDOM, GATE_SIGMAS, SLIGHT
from vo_service.odometry.direct.quality import rejection_reason
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.region_weights import weigh_regions

# Columns of cells that are left out: half of the view, on the left, in the middle, on the right.
MASKED_COLUMNS = (slice(0, 4), slice(2, 6), slice(4, 8))


def retry_without_half(
    result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> TrackingResult:
    """The same, or the motion without half of the view that fits better and surprises less."""
    if (
        motion_state.innovation_ratio(result.alignment.camera_velocity, images.stamp_s)
        < GATE_SIGMAS
    ):
        return result
    others = [_align_without(half, result, images, motion_state) for half in MASKED_COLUMNS]
    motions = [result.alignment, *(other for other in others if not rejection_reason(other))]
    spreads = np.min([motion.residual_model for motion in motions], axis=0)[SIGMA_BRIGHTNESS:]
    points = result.keyframe.points[0]

    def cost(motion: DirectAlignment) -> float:
        surprise = motion_state.innovation_ratio(motion.camera_velocity, images.stamp_s)
        return _mean_cost(points, motion, spreads) + SLIGHT * log(
            1 + surprise**2 / DEGREES_OF_FREEDOM
        )

    return replace(result, alignment=min(motions, key=cost))


def _align_without(
    masked_columns: slice, result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> DirectAlignment:
    """The motion of half of the view, then of all that fits it."""
    points, tie = result.keyframe.points, result.prior
    weights = uniform_weights()
    weights.reshape(2, CELL_ROWS, CELL_COLUMNS)[:, :, masked_columns] = 0.0
    expected = motion_state.initial_guesses(result.keyframe.T_world_keyframe, images.stamp_s)[:1]
    part = align(
        points, images, expected, tie, motion_state.predict_affine_brightness(images), weights
    )
    by_region = weigh_regions(points[0], part.samples, part.residual_model, uniform_weights())
    fitting = (by_region >= residual_stats.MIN_STATIC_WEIGHT).astype(np.float64)
    return align(
        points[:NUM_FINE_LEVELS],
        images,
        [part.T_camera_keyframe],
        tie,
        part.affine_brightness,
        fitting,
    )


def _mean_cost(points: Array, alignment: DirectAlignment, sigmas: Array) -> float:
    """Mean robust cost of a reading in all of the view, by spreads (2,) that are given."""
    fit = alignment.residual_model.copy()
    fit[SIGMA_BRIGHTNESS:] = sigmas
    counts = residual_stats.count_residuals(points, alignment.samples, fit, uniform_weights())
    read = counts[residual_stats.WITH_DEPTH] + counts[residual_stats.WITH_BRIGHTNESS]
    return float(counts[residual_stats.COST] / max(read, 1.0))
