"""Search for the timing over a few frames: the odometry is run on them with several timings.

The estimate by normal equations needs a timing near the right one, and so does the tracking of fast
motion. Timings are compared by the residuals that they leave.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import (
    MAX_TIMING_SIGMAS_S,
    SEARCH_SCORE_SCALE,
    SEARCH_SIGMAS_S,
    SEARCH_STEPS_S,
)
from vo_service.odometry.direct.residuals import SIGMA_BRIGHTNESS, SIGMA_DEPTH
from vo_service.odometry.direct.timing_frames import TimedFrame


@dataclass(frozen=True)
class TimingSearchResult:
    """The timing that fits best, as a correction of what the frames tell.

    Attributes:
        mean: (2,) readout and delay, s; exactly zero if nothing fits clearly better than no
            correction.
        sigmas_s: (2,) standard deviations.
    """

    mean: Array
    sigmas_s: Array


def needs_search(sigmas_s: Array) -> bool:
    """Whether a timing is too uncertain to start with."""
    return bool((sigmas_s > MAX_TIMING_SIGMAS_S).any())


def search_timing(
    frames: Sequence[TimedFrame], sigmas_s: Array, make_tracker: Callable[[], DirectOdometry]
) -> TimingSearchResult:
    """Search for the timing of frames.

    Args:
        frames: Consecutive frames with motion.
        sigmas_s: (2,) standard deviations of what the frames tell.
        make_tracker: Makes an odometry that starts at the first frame.
    """
    corrections = _make_corrections(frames[0].told, sigmas_s)
    scores = np.array(
        [
            _score([frame.with_correction(c) for frame in frames], make_tracker())
            for c in corrections
        ]
    )
    scores = (scores - scores.min()) / SEARCH_SCORE_SCALE
    scores += 0.5 * np.square(corrections / np.maximum(sigmas_s, 1e-9)).sum(axis=1)
    weights = np.exp(scores.min() - scores)
    weights /= weights.sum()
    mean = weights @ corrections
    spread = weights @ np.square(corrections - mean)
    sigmas = np.minimum(np.sqrt(spread + np.square(SEARCH_SIGMAS_S)), sigmas_s)
    # Frames that hardly tell one timing from another change nothing.
    is_corrected = scores[0] > scores.min() + 1.0
    return TimingSearchResult(mean if is_corrected else np.zeros(2), sigmas)


def _make_corrections(told: Array, sigmas_s: Array) -> Array:
    """(N, 2) corrections to try of the values that are uncertain, the first one zero."""
    is_uncertain = sigmas_s > MAX_TIMING_SIGMAS_S
    readout_step, delay_step = np.where(is_uncertain, SEARCH_STEPS_S, 0.0)
    # A readout is never negative.
    readouts = (0.0, readout_step, 2.0 * readout_step if told[0] < readout_step else -readout_step)
    pairs = [(r, d) for r in readouts for d in (0.0, delay_step, -delay_step)]
    return np.array(list(dict.fromkeys(pairs)))


def _score(frames: Sequence[RgbdFrame], tracker: DirectOdometry) -> float:
    """Sum of the logarithms of the residuals' sigmas; a frame that fails counts as zero."""
    score = 0.0
    for frame in frames:
        estimate, tracked = tracker.estimate(frame), tracker.last_frame
        if estimate.ok and tracked is not None and tracked.images.stamp_s == frame.stamp_s:
            model = tracked.result.alignment.residual_model
            score += np.log(model[SIGMA_BRIGHTNESS]) + np.log(model[SIGMA_DEPTH])
    return float(score)
