"""Estimation of a sensor's readout time and depth offset from fast motion."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from vo_service.tools.calibration.motion_segments import SEGMENT_FRAMES, MotionSegment
from vo_service.tools.calibration.timing_cost import SensorTiming, timing_costs
from vo_service.tools.calibration.timing_search import (
    NOTHING_SAVED_PREFIX,
    TimingMinimum,
    find_minimum,
)

# Minimum number of segments; the search starts with this many of the fastest.
MIN_SEGMENTS, COARSE_SEGMENTS = 4, 4
# Slower segments do not determine the timing.
MIN_SPEED_SIGMA_RAD_S = 0.05
# Largest standard deviations that are saved, of the readout and of the depth offset.
MAX_READOUT_SIGMA_S, MAX_DEPTH_OFFSET_SIGMA_S = 0.002, 0.0012
# A smaller readout cannot be zero within its uncertainty.
MIN_READOUT_S = -0.004
# Digits of saved seconds, below the accuracy.
DIGITS = 5
REMEDY = (
    "shake the camera to and fro like a hand, for a minute, near objects with texture and depth"
)


@dataclass(frozen=True)
class TimingEstimate:
    """Estimated timing with standard deviations."""

    timing: SensorTiming
    sigma: SensorTiming
    segment_count: int


def estimate_timing(
    segments: Sequence[MotionSegment], on_progress: Callable[[str], None]
) -> TimingEstimate:
    """Estimate the timing that explains the segments best.

    Args:
        segments: Segments, the fastest first; their frames have the skew of their stamps only.
        on_progress: Is called with a description of each step.

    Raises:
        UserFacingError: The segments do not determine the timing.
    """
    check_motion(segments)
    minimum = find_minimum(
        _make_cost_function(segments[:COARSE_SEGMENTS], on_progress),
        _make_cost_function(segments, on_progress),
    )
    return validate_minimum(minimum)


def check_motion(segments: Sequence[MotionSegment]) -> None:
    """Raise UserFacingError if there is obviously too little motion."""
    if len(segments) < MIN_SEGMENTS:
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the recording is too short: {len(segments)} segments of "
            f"{SEGMENT_FRAMES} frames without a gap, at least {MIN_SEGMENTS} are needed; "
            "record one minute"
        )
    speed_sigma_deg_s = math.degrees(segments[MIN_SEGMENTS - 1].speed_sigma_rad_s)
    if speed_sigma_deg_s < math.degrees(MIN_SPEED_SIGMA_RAD_S):
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the camera moved too slowly to determine its timing: its speed "
            f"changed by {speed_sigma_deg_s:.1f} degrees a second (at least "
            f"{math.degrees(MIN_SPEED_SIGMA_RAD_S):.0f} are needed); {REMEDY}"
        )


def validate_minimum(minimum: TimingMinimum) -> TimingEstimate:
    """Return the estimate.

    Raises:
        UserFacingError: If it is too uncertain.
    """
    sigma_ms = 1e3 * minimum.sigma_s
    if not (minimum.sigma_s <= [MAX_READOUT_SIGMA_S, MAX_DEPTH_OFFSET_SIGMA_S]).all():
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the camera moved too slowly or too little to determine its "
            f"timing: readout ±{sigma_ms[0]:.1f} ms (at most {1e3 * MAX_READOUT_SIGMA_S:g}), "
            f"depth offset ±{sigma_ms[1]:.1f} ms (at most {1e3 * MAX_DEPTH_OFFSET_SIGMA_S:g}); "
            f"{REMEDY}"
        )
    readout_s, depth_offset_s = (round(float(value), DIGITS) for value in minimum.timing_s)
    if readout_s < MIN_READOUT_S:
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the rows seem to be read from bottom to top, in "
            f"{-1e3 * readout_s:.0f} ms; check that the images are not upside down"
        )
    return TimingEstimate(
        SensorTiming(max(readout_s, 0.0), depth_offset_s),
        SensorTiming(*map(float, minimum.sigma_s)),
        minimum.segment_count,
    )


def _make_cost_function(
    segments: Sequence[MotionSegment], on_progress: Callable[[str], None]
) -> Callable[[Array, Array], Array]:
    def cost_table(assumed_s: Array, candidates_s: Array) -> Array:
        assumed = SensorTiming(*assumed_s)
        candidates = [SensorTiming(*candidate_s) for candidate_s in candidates_s]
        rows = []
        for number, segment in enumerate(segments, 1):
            readout_ms, offset_ms = 1e3 * assumed_s
            on_progress(
                f"around readout {readout_ms:.1f} ms, depth offset {offset_ms:.1f} ms: "
                f"segment {number}/{len(segments)}"
            )
            rows.append(timing_costs(segment.frames, assumed, candidates))
        return np.array(rows)

    return cost_table
