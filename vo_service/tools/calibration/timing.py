"""Readout and depth offset of a sensor from brisk motion, or why they cannot be told."""

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

# Film with fewer pieces is too short; the search begins with so many of the briskest.
MIN_SEGMENTS, COARSE_SEGMENTS = 4, 4
# An image that moves less briskly than this tells nothing.
MIN_SPEED_SIGMA_RAD_S = 0.05
# Largest standard deviations that are saved, of the readout and of the depth offset.
MAX_READOUT_SIGMA_S, MAX_DEPTH_OFFSET_SIGMA_S = 0.002, 0.0012
# A readout further below zero than this is none that was not told from zero.
MIN_READOUT_S = -0.004
# Seconds are rounded to so many digits: less than what can be found.
DIGITS = 5
REMEDY = (
    "shake it to and fro as one shakes a hand, for a minute, near things with a pattern and depth"
)


@dataclass(frozen=True)
class TimingEstimate:
    """What was found, and its standard deviations."""

    timing: SensorTiming
    sigma: SensorTiming
    segment_count: int


def estimate_timing(
    segments: Sequence[MotionSegment], on_progress: Callable[[str], None]
) -> TimingEstimate:
    """The timing that explains the pieces of a film best; the briskest piece comes first.

    Frames carry the skew of their stamps alone. `tell` gets what is being done.
    Raises UserFacingError if the film does not tell the timing.
    """
    check_motion(segments)
    found = find_minimum(
        _make_cost_function(segments[:COARSE_SEGMENTS], on_progress),
        _make_cost_function(segments, on_progress),
    )
    return validate_minimum(found)


def check_motion(segments: Sequence[MotionSegment]) -> None:
    """Raise UserFacingError where nothing has to be tried to know that it is too little."""
    if len(segments) < MIN_SEGMENTS:
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the film is too short: {len(segments)} stretches of {SEGMENT_FRAMES} "
            f"frames without a gap, at least {MIN_SEGMENTS} are needed; give it a minute"
        )
    shake_deg_s = math.degrees(segments[MIN_SEGMENTS - 1].speed_sigma_rad_s)
    if shake_deg_s < math.degrees(MIN_SPEED_SIGMA_RAD_S):
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the camera moved too slowly to tell its timing: its speed changed by "
            f"{shake_deg_s:.1f} degrees a second (at least {math.degrees(MIN_SPEED_SIGMA_RAD_S):.0f} "
            f"are needed); {REMEDY}"
        )


def validate_minimum(minimum: TimingMinimum) -> TimingEstimate:
    """What is sure enough. Raises UserFacingError for what is not."""
    sigma_ms = 1e3 * minimum.sigma_s
    if not (minimum.sigma_s <= [MAX_READOUT_SIGMA_S, MAX_DEPTH_OFFSET_SIGMA_S]).all():
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the camera moved too slowly or too little to tell its timing: readout "
            f"±{sigma_ms[0]:.1f} ms (at most {1e3 * MAX_READOUT_SIGMA_S:g}), depth offset "
            f"±{sigma_ms[1]:.1f} ms (at most {1e3 * MAX_DEPTH_OFFSET_SIGMA_S:g}); {REMEDY}"
        )
    readout_s, depth_offset_s = (round(float(value), DIGITS) for value in minimum.timing_s)
    if readout_s < MIN_READOUT_S:
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the rows seem to be read from bottom to top, in "
            f"{-1e3 * readout_s:.0f} ms; are the images upside down?"
        )
    return TimingEstimate(
        SensorTiming(max(readout_s, 0.0), depth_offset_s),
        SensorTiming(*map(float, minimum.sigma_s)),
        minimum.segment_count,
    )


def _make_cost_function(
    segments: Sequence[MotionSegment], on_progress: Callable[[str], None]
) -> Callable[[Array, Array], Array]:
    def table(known_s: Array, tried_s: Array) -> Array:
        known, tried = SensorTiming(*known_s), [SensorTiming(*each) for each in tried_s]
        rows = []
        for number, piece in enumerate(segments, 1):
            readout_ms, offset_ms = 1e3 * known_s
            on_progress(
                f"around readout {readout_ms:.1f} ms, depth offset {offset_ms:.1f} ms: "
                f"piece {number}/{len(segments)}"
            )
            rows.append(timing_costs(piece.frames, known, tried))
        return np.array(rows)

    return table
