"""Readout and depth offset of a sensor from brisk motion, or why they cannot be told."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.errors import UserFacingError
from drivers.geometry import Array
from vo_service.calibration.timing_cost import Timing, costs
from vo_service.calibration.timing_pieces import PIECE_FRAMES, Piece
from vo_service.calibration.timing_search import NOTHING_SAVED, Minimum, search

# Film with fewer pieces is too short; the search begins with so many of the briskest.
FEWEST_PIECES, COARSE_PIECES = 4, 4
# An image that moves less briskly than this tells nothing.
LEAST_SHAKE_RAD_S = 0.05
# Largest standard deviations that are saved, of the readout and of the depth offset.
READOUT_SIGMA_S, OFFSET_SIGMA_S = 0.002, 0.0012
# A readout further below zero than this is none that was not told from zero.
LEAST_READOUT_S = -0.004
# Seconds are rounded to so many digits: less than what can be found.
DIGITS = 5
REMEDY = (
    "shake it to and fro as one shakes a hand, for a minute, near things with a pattern and depth"
)


@dataclass(frozen=True)
class MeasuredTiming:
    """What was found, and its standard deviations."""

    timing: Timing
    sigma: Timing
    pieces: int


def measure(pieces: Sequence[Piece], tell: Callable[[str], None]) -> MeasuredTiming:
    """The timing that explains the pieces of a film best; the briskest piece comes first.

    Frames carry the skew of their stamps alone. `tell` gets what is being done.
    Raises UserFacingError if the film does not tell the timing.
    """
    check_motion(pieces)
    found = search(_costs_of(pieces[:COARSE_PIECES], tell), _costs_of(pieces, tell))
    return judged(found)


def check_motion(pieces: Sequence[Piece]) -> None:
    """Raise UserFacingError where nothing has to be tried to know that it is too little."""
    if len(pieces) < FEWEST_PIECES:
        raise UserFacingError(
            f"{NOTHING_SAVED}the film is too short: {len(pieces)} stretches of {PIECE_FRAMES} "
            f"frames without a gap, at least {FEWEST_PIECES} are needed; give it a minute"
        )
    shake_deg_s = math.degrees(pieces[FEWEST_PIECES - 1].shake_rad_s)
    if shake_deg_s < math.degrees(LEAST_SHAKE_RAD_S):
        raise UserFacingError(
            f"{NOTHING_SAVED}the camera moved too slowly to tell its timing: its speed changed by "
            f"{shake_deg_s:.1f} degrees a second (at least {math.degrees(LEAST_SHAKE_RAD_S):.0f} "
            f"are needed); {REMEDY}"
        )


def judged(found: Minimum) -> MeasuredTiming:
    """What is sure enough. Raises UserFacingError for what is not."""
    sigma_ms = 1e3 * found.sigma_s
    if not (found.sigma_s <= [READOUT_SIGMA_S, OFFSET_SIGMA_S]).all():
        raise UserFacingError(
            f"{NOTHING_SAVED}the camera moved too slowly or too little to tell its timing: readout "
            f"±{sigma_ms[0]:.1f} ms (at most {1e3 * READOUT_SIGMA_S:g}), depth offset "
            f"±{sigma_ms[1]:.1f} ms (at most {1e3 * OFFSET_SIGMA_S:g}); {REMEDY}"
        )
    readout_s, depth_offset_s = (round(float(value), DIGITS) for value in found.timing_s)
    if readout_s < LEAST_READOUT_S:
        raise UserFacingError(
            f"{NOTHING_SAVED}the rows seem to be read from bottom to top, in "
            f"{-1e3 * readout_s:.0f} ms; are the images upside down?"
        )
    return MeasuredTiming(
        Timing(max(readout_s, 0.0), depth_offset_s),
        Timing(*map(float, found.sigma_s)),
        found.pieces,
    )


def _costs_of(
    pieces: Sequence[Piece], tell: Callable[[str], None]
) -> Callable[[Array, Array], Array]:
    def table(known_s: Array, tried_s: Array) -> Array:
        known, tried = Timing(*known_s), [Timing(*each) for each in tried_s]
        rows = []
        for number, piece in enumerate(pieces, 1):
            readout_ms, offset_ms = 1e3 * known_s
            tell(
                f"around readout {readout_ms:.1f} ms, depth offset {offset_ms:.1f} ms: "
                f"piece {number}/{len(pieces)}"
            )
            rows.append(costs(piece.frames, known, tried))
        return np.array(rows)

    return table
