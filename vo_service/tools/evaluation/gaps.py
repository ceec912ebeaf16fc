"""Gaps in a recording, and how an odometry crosses them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.tools.evaluation.metrics import (
    STAMP_ROUNDING_S,
    MatchedPoses,
    PosePairs,
    RelativeErrors,
    relative_errors,
)

# A gap is longer than this many median frame periods, and longer than this time.
MIN_GAP_STEPS = 3.0
MIN_GAP_S = 0.2


@dataclass(frozen=True)
class Gap:
    """Gap between two frames: stamps of the last frame before it and of the first after it."""

    begin_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """Time between the two frames, s."""
        return self.end_s - self.begin_s


@dataclass(frozen=True)
class GapOutcome:
    """Result of an odometry at a gap.

    Attributes:
        was_lost_before: The frame before the gap had no pose.
        lost_frames: Frames after the gap without a pose, up to the first one with a pose.
        is_recovered: A frame after the gap has a pose.
        has_new_epoch: That pose is not continuous with those before the gap.
    """

    was_lost_before: bool
    lost_frames: int
    is_recovered: bool
    has_new_epoch: bool

    def __str__(self) -> str:
        count = f"{self.lost_frames} frame{'' if self.lost_frames == 1 else 's'}"
        if not self.is_recovered:
            outcome = f"lost to the end ({count})"
        elif self.has_new_epoch:
            outcome = f"lost {count}, then a new epoch" if self.lost_frames else "new epoch at once"
        else:
            outcome = f"lost {count}, then recovered" if self.lost_frames else "kept tracking"
        return f"already lost before it; {outcome}" if self.was_lost_before else outcome


def find_gaps(stamps_s: Array) -> list[Gap]:
    """Return the gaps between (N,) ascending stamps of frames."""
    steps_s = np.diff(stamps_s)
    if not len(steps_s):
        return []
    max_step_s = max(MIN_GAP_S, MIN_GAP_STEPS * float(np.median(steps_s)))
    before = np.flatnonzero(steps_s > max_step_s)
    return [Gap(float(stamps_s[k]), float(stamps_s[k + 1])) for k in before]


def classify_gap(
    gap: Gap, stamps_s: Array, is_good: NDArray[np.bool_], epochs: NDArray[np.int64]
) -> GapOutcome:
    """Return how a gap was crossed, by stamp, success and epoch of each of the N frames."""
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
    """Return the error of the motion across a gap, or None if one side has no pose."""
    before = np.flatnonzero(matched.stamps_s <= gap.begin_s + STAMP_ROUNDING_S)
    after = np.flatnonzero(matched.stamps_s >= gap.end_s - STAMP_ROUNDING_S)
    if not len(before) or not len(after):
        return None
    return relative_errors(matched, PosePairs(before[-1:], after[:1]))


def spans_gap(matched: MatchedPoses, pairs: PosePairs, gaps: list[Gap]) -> NDArray[np.bool_]:
    """Return (K,) whether the poses of each of K pairs lie on both sides of a gap."""
    earlier_s, later_s = matched.stamps_s[pairs.earlier], matched.stamps_s[pairs.later]
    is_across = np.zeros(len(pairs), np.bool_)
    for gap in gaps:
        has_before = earlier_s <= gap.begin_s + STAMP_ROUNDING_S
        is_across |= has_before & (later_s >= gap.end_s - STAMP_ROUNDING_S)
    return is_across
