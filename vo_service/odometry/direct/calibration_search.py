"""Search for the timing: the first moving frames are tracked with several timings side by side.

The estimate by normal equations needs a timing near the right one, and so does the tracking of fast
motion. Timings are compared by the residuals that they leave. Each of them has a small tracker: one
keyframe with a quarter of the usual points.
"""

from dataclasses import dataclass, replace

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.image_pyramid import CELL_COLUMNS, CELL_ROWS, ImagePyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.keyframe_correction import (
    correct_shutter,
)
from vo_service.odometry.direct.keyframe_selection import rebuild_first_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    MAX_CALIBRATION_SIGMAS,
    MIN_SEARCH_SCORE_GAIN,
    NUM_SEARCHED_FRAMES,
    SEARCH_SCORE_SCALE,
    SEARCH_STEPS_S,
    SUFFICIENT_SEARCH_SCORE_GAIN,
)
from vo_service.odometry.direct.quality import TrackingResult, rejection_reason
from vo_service.odometry.direct.view_history import NUM_VELOCITY_POSES, Pose, velocity_at

# A quarter of the cells, spread over the image: a tracker of the search takes its points from them.
SEARCHED_CELLS = np.array(
    [(row * 2 + column) % 4 == 0 for row in range(CELL_ROWS) for column in range(CELL_COLUMNS)]
)


class TimingHypothesis:
    """A timing, and a small tracker that uses it.

    Args:
        correction: (2,) of what the frames tell, s.
        keyframe: The first frame, of a camera at rest: its points have no time.

    Attributes:
        correction: See above.
        scores: Of each frame but the first: its negative log-likelihood; zero if tracking failed.
    """

    def __init__(self, correction: Array, keyframe: DirectKeyframe) -> None:
        images = replace(
            keyframe.images, shutter=correct_shutter(keyframe.images.shutter, correction)
        )
        self.correction = correction
        self._keyframe = replace(keyframe, images=images)
        self.motion_state = MotionState.at_rest(keyframe.T_world_keyframe, images.stamp_s)
        self.scores: list[float] = []
        self._last: tuple[ImagePyramid, TrackingResult] | None = None  # frame and its alignment
        self.poses: list[Pose] = [(keyframe.images.stamp_s, keyframe.T_world_keyframe)]

    @property
    def velocity_of_first(self) -> Array:
        """(6,) twist of the camera at the first frame, in its own axes, m/s and rad/s."""
        return velocity_at(self.poses[:NUM_VELOCITY_POSES], 0)

    @property
    def is_well_constrained(self) -> bool:
        """Whether the last frame was tracked, and shows more than one plane."""
        if self._last is None or rejection_reason(self._last[1].alignment):
            return False
        images, result = self._last
        uncertainty = estimate_uncertainty(
            result.keyframe.points, images, result.alignment, result.prior, np.zeros(2)
        )
        return not uncertainty.is_one_plane

    def track(self, images: ImagePyramid) -> None:
        """Align the next frame with the keyframe."""
        images = replace(images, shutter=correct_shutter(images.shutter, self.correction))
        result = self._align(images)
        self._last = images, result
        if rejection_reason(result.alignment):
            self.scores.append(0.0)
            return
        if len(self.poses) == 1:
            result = rebuild_first_keyframe(result, images, SEARCHED_CELLS)
            self._keyframe = result.keyframe
        state = self.motion_state
        self.motion_state = state.advance(
            result.T_world_camera,
            result.alignment.camera_velocity,
            images.stamp_s,
            result.alignment.gain,
            state.normalized_innovation,
            images.stamp_s,
        )
        self.scores.append(result.negative_log_likelihood)
        self.poses.append((images.stamp_s, result.T_world_camera))

    def _align(self, images: ImagePyramid) -> TrackingResult:
        keyframe, state = self._keyframe, self.motion_state
        prior = state.motion_prior(keyframe.T_world_keyframe, images.stamp_s)
        alignment = align(
            keyframe.points,
            images,
            state.predict_alignment(keyframe.T_world_keyframe, images.stamp_s),
            prior,
            state.gain,
            uniform_weights(),
        )
        return TrackingResult(keyframe, alignment, prior)


@dataclass(frozen=True)
class TimingSearchResult:
    """The timing that fits best, as a correction of what the frames tell.

    Attributes:
        mean: (2,) readout and delay, s.
        sigmas_s: (2,) standard deviations.
        score_gain: By how much the best hypothesis fits better than no correction.
        best: That hypothesis.
        count: Number of frames that were compared.
        is_degraded: Whether most of them are: without texture or shape, or in a degenerate view,
            frames hardly tell timings apart.
    """

    mean: Array
    sigmas_s: Array
    score_gain: float
    best: TimingHypothesis
    count: int
    is_degraded: bool

    @property
    def is_clear(self) -> bool:
        """Whether no correction is clearly wrong; else frames hardly tell timings apart."""
        return self.is_sufficient or (
            not self.is_degraded and self.score_gain > MIN_SEARCH_SCORE_GAIN
        )

    @property
    def is_last(self) -> bool:
        """Whether no more frames are needed."""
        return self.is_sufficient or self.count >= NUM_SEARCHED_FRAMES - 1

    @property
    def is_sufficient(self) -> bool:
        """Whether the best hypothesis fits so much better that no more frames are needed."""
        return self.score_gain > SUFFICIENT_SEARCH_SCORE_GAIN


def needs_search(sigmas_s: Array) -> bool:
    """Whether a timing with these standard deviations (2,) is too uncertain to start with."""
    return bool((sigmas_s > MAX_CALIBRATION_SIGMAS[:2]).any())


class TimingSearch:
    """Tracks frames with several timings, and compares their residuals.

    Args:
        sigmas_s: (2,) standard deviations of the timing that the frames tell.
        keyframe: The first frame, of a camera at rest.

    Attributes:
        keyframe: See above.
        hypotheses: The timings that are compared, no correction first.
    """

    def __init__(self, sigmas_s: Array, keyframe: DirectKeyframe) -> None:
        self._sigmas_s, self.keyframe = sigmas_s, keyframe
        self._frames: list[ImagePyramid] = []
        self._num_degraded = 0
        # Of a camera at rest it is the same for each timing.
        self._sparse = make_keyframe(
            keyframe.frame,
            keyframe.images,
            keyframe.T_world_keyframe,
            zero_motion(),
            SEARCHED_CELLS,
        )
        self.hypotheses = [
            TimingHypothesis(correction, self._sparse)
            for correction in _make_corrections(keyframe.images.shutter.readout_s, sigmas_s)
        ]

    def add(self, images: ImagePyramid, is_degraded: bool = False) -> None:
        """Track a frame with each timing.

        Args:
            images: The frame.
            is_degraded: Whether its estimate is.
        """
        self._frames.append(images)
        self._num_degraded += is_degraded
        for hypothesis in self.hypotheses:
            hypothesis.track(images)

    def track_with(self, correction: Array) -> TimingHypothesis:
        """Track the frames so far with another timing (2,)."""
        hypothesis = TimingHypothesis(correction, self._sparse)
        for images in self._frames:
            hypothesis.track(images)
        return hypothesis

    def evaluate(self) -> TimingSearchResult:
        """Return the timing by the frames so far."""
        corrections = np.array([hypothesis.correction for hypothesis in self.hypotheses])
        scores = np.array([sum(hypothesis.scores) for hypothesis in self.hypotheses])
        scores = (scores - scores.min()) / SEARCH_SCORE_SCALE
        scores += 0.5 * np.square(corrections / np.maximum(self._sigmas_s, 1e-9)).sum(axis=1)
        weights = np.exp(scores.min() - scores)
        weights /= weights.sum()
        mean = weights @ corrections
        # The timing may be between those that were tried.
        variance = weights @ np.square(corrections - mean) + np.square(SEARCH_STEPS_S) / 4.0
        return TimingSearchResult(
            mean,
            np.minimum(np.sqrt(variance), self._sigmas_s),
            float(scores[0] - scores.min()),
            self.hypotheses[int(np.argmin(scores))],
            len(self._frames),
            2 * self._num_degraded >= len(self._frames),
        )


def _make_corrections(readout_s: float, sigmas_s: Array) -> Array:
    """(N, 2) corrections to try of the values that are uncertain, the first one zero."""
    is_uncertain = sigmas_s > MAX_CALIBRATION_SIGMAS[:2]
    readout_step, delay_step = np.where(is_uncertain, SEARCH_STEPS_S, 0.0)
    # A readout is never negative.
    readouts = (
        0.0,
        readout_step,
        2.0 * readout_step if readout_s < readout_step else -readout_step,
    )
    pairs = [(r, d) for r in readouts for d in (0.0, delay_step, -delay_step)]
    return np.array(list(dict.fromkeys(pairs)))
