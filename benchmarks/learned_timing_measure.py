"""How soon and how well an odometry learns the sensor's timing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy import Accuracy
from benchmarks.hard_cases_measure import TrackedSequence
from drivers.core.geometry import Array
from vo_service.types import OnlineTiming

# Errors of readout and delay from which on the timing counts as learned.
LEARNED_ERRORS_S = (0.002, 0.0015)
CONSISTENT_SIGMAS = 3.0


@dataclass(frozen=True)
class LearnedTiming:
    """Result of one recording.

    Attributes:
        told: Accuracy with the exact timing.
        untold: Accuracy with no timing told.
        truth_s: True readout and delay.
        learned_s: Both after the last frame.
        sigmas_s: Their published standard deviations.
        settling_s: Time from the first frame until both errors stay within `LEARNED_ERRORS_S`;
            None if they do not.
        seconds: Number of seconds, after each of which the timing was compared with the truth.
        consistent: Those in which both errors are within `CONSISTENT_SIGMAS`.
        nonzero: Frames with a readout or a delay other than exactly zero.
    """

    told: Accuracy
    untold: Accuracy
    truth_s: tuple[float, float]
    learned_s: tuple[float, float]
    sigmas_s: tuple[float, float]
    settling_s: float | None
    seconds: int
    consistent: int
    nonzero: int


def evaluate_timing(
    told: Accuracy, untold: Accuracy, tracked: TrackedSequence, truth_s: tuple[float, float]
) -> LearnedTiming:
    """Compare the timing that was published with each frame with the truth.

    Args:
        told: Accuracy with the exact timing.
        untold: Accuracy of `tracked`.
        tracked: Estimates with a timing, of at least one frame.
        truth_s: True readout and delay.
    """
    timings = [estimate.timing for estimate in tracked.estimates]
    published = np.array([_as_row(timing) for timing in timings if timing is not None])
    errors_s, sigmas_s = np.abs(published[:, :2] - truth_s), published[:, 2:]
    times_s = tracked.stamps_s - tracked.stamps_s[0]
    is_consistent = np.all(errors_s <= CONSISTENT_SIGMAS * sigmas_s, axis=1)[_second_ends(times_s)]
    return LearnedTiming(
        told=told,
        untold=untold,
        truth_s=truth_s,
        learned_s=(published[-1, 0], published[-1, 1]),
        sigmas_s=(published[-1, 2], published[-1, 3]),
        settling_s=_settling_time_s(times_s, errors_s),
        seconds=len(is_consistent),
        consistent=int(is_consistent.sum()),
        nonzero=int(np.count_nonzero(np.any(published[:, :2] != 0.0, axis=1))),
    )


def _as_row(timing: OnlineTiming) -> tuple[float, float, float, float]:
    return (
        timing.readout_s,
        timing.depth_offset_s,
        timing.readout_sigma_s,
        timing.depth_offset_sigma_s,
    )


def _second_ends(times_s: Array) -> NDArray[np.int64]:
    """The last frame of each second that has frames."""
    seconds = np.floor(times_s + 1e-6)
    return np.flatnonzero(np.append(np.diff(seconds) > 0, True))


def _settling_time_s(times_s: Array, errors_s: Array) -> float | None:
    """Time of the first frame from which on all errors are within `LEARNED_ERRORS_S`."""
    wrong = np.flatnonzero((errors_s > LEARNED_ERRORS_S).any(axis=1))
    if not len(wrong):
        return 0.0
    return float(times_s[wrong[-1] + 1]) if wrong[-1] + 1 < len(times_s) else None
