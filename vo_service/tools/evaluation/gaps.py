"""Pauses in a recording: where they are, and how an odometry comes across them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.tools.evaluation.association import STAMP_ROUNDING_S, MatchedPoses
from vo_service.tools.evaluation.metrics import PosePairs, RelativeErrors, relative_errors

# A pause is longer than this many usual times from frame to frame, and than this.
MIN_GAP_STEPS = 3.0
MIN_GAP_S = 0.2


@dataclass(frozen=True)
class Gap:
    """A pause: stamps of the last frame before it and of the first one after it."""

    begin_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """From the one frame to the other."""
        return self.end_s - self.begin_s


@dataclass(frozen=True)
class GapOutcome:
    """How an odometry came across a pause.

    was_lost     the frame before the pause had no pose already
    lost_frames  frames after the pause without a pose, up to the first that has one
    is_found     there is such a first one; else all frames to the end are lost
    new_epoch    its pose is not continuous with those before the pause
    """

    was_lost_before: bool
    lost_frames: int
    is_recovered: bool
    has_new_epoch: bool

    def __str__(self) -> str:
        count = f"{self.lost_frames} frame{'' if self.lost_frames == 1 else 's'}"
        if not self.is_recovered:
            across = f"lost to the end ({count})"
        elif self.has_new_epoch:
            across = f"lost {count}, then a new epoch" if self.lost_frames else "new epoch at once"
        else:
            across = f"lost {count}, then found again" if self.lost_frames else "followed on"
        return f"lost already before it; {across}" if self.was_lost_before else across


def find_gaps(stamps_s: Array) -> list[Gap]:
    """The pauses between (N,) rising stamps of frames."""
    steps_s = np.diff(stamps_s)
    if not len(steps_s):
        return []
    longest_s = max(MIN_GAP_S, MIN_GAP_STEPS * float(np.median(steps_s)))
    before = np.flatnonzero(steps_s > longest_s)
    return [Gap(float(stamps_s[k]), float(stamps_s[k + 1])) for k in before]


def classify_gap(
    gap: Gap, stamps_s: Array, is_good: NDArray[np.bool_], epochs: NDArray[np.int64]
) -> GapOutcome:
    """How the frames (N,), each with a pose or not and of its epoch, come across a pause."""
    first = int(np.searchsorted(stamps_s, gap.end_s - STAMP_ROUNDING_S))
    good = np.flatnonzero(is_good[first:])
    lost = int(good[0]) if len(good) else len(stamps_s) - first
    has_before = first > 0
    return GapOutcome(
        was_lost_before=has_before and not is_good[first - 1],
        lost_frames=lost,
        is_recovered=bool(len(good)),
        has_new_epoch=bool(has_before and len(good) and epochs[first + lost] != epochs[first - 1]),
    )


def gap_error(matched: MatchedPoses, gap: Gap) -> RelativeErrors | None:
    """Error of the motion from the last pose before the pause to the first after it; or None."""
    before = np.flatnonzero(matched.stamps_s <= gap.begin_s + STAMP_ROUNDING_S)
    after = np.flatnonzero(matched.stamps_s >= gap.end_s - STAMP_ROUNDING_S)
    if not len(before) or not len(after):
        return None
    return relative_errors(matched, PosePairs(before[-1:], after[:1]))


def spans_gap(matched: MatchedPoses, pairs: PosePairs, gaps: list[Gap]) -> NDArray[np.bool_]:
    """(K,) whether a pair of poses lies on both sides of a pause."""
    earlier_s, later_s = matched.stamps_s[pairs.earlier], matched.stamps_s[pairs.later]
    is_across = np.zeros(len(pairs), np.bool_)
    for gap in gaps:
        has_before = earlier_s <= gap.begin_s + STAMP_ROUNDING_S
        is_across |= has_before & (later_s >= gap.end_s - STAMP_ROUNDING_S)
    return is_across
