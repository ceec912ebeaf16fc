"""Search for the timing: the first moving frames are tracked with several timings side by side.

The estimate by normal equations needs a timing near the right one, and so does the tracking of fast
motion. Timings are compared by the residuals that they leave. Each of them has a small tracker: one
keyframe with a quarter of the usual points. The work of a frame is bounded, so that a live camera
keeps its rate: a tracker may be some frames behind.
"""

from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.image_pyramid import (
    CELL_COLUMNS,
    CELL_ROWS,
    ImagePyramid,
    build_image_pyramid,
)
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.keyframe_selection import rebuild_first_keyframe
from vo_service.odometry.direct.motion import ACCELERATION_START, zero_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    BRIGHTNESS_WEIGHT,
    MAX_CALIBRATION_SIGMAS,
    MAX_SEARCH_STEPS_PER_FRAME,
    MIN_SEARCH_SCORE_GAIN,
    NUM_SEARCHED_FRAMES,
    SEARCH_SCORE_SCALE,
    SEARCH_SIGMAS_S,
    SEARCH_STEPS_S,
    SUFFICIENT_SEARCH_SCORE_GAIN,
)
from vo_service.odometry.direct.quality import TrackingResult, rejection_reason
from vo_service.odometry.direct.view_history import (
    NUM_FIRST_VELOCITY_POSES,
    ToldFrame,
    TrackedView,
    corrected_shutter,
    velocity_at,
)

# A quarter of the cells, spread over the image: a tracker of the search takes its points from them.
SEARCHED_CELLS = np.array(
    [(row * 2 + column) % 4 == 0 for row in range(CELL_ROWS) for column in range(CELL_COLUMNS)]
)
# Steps that a tracker's start costs: two alignments, and a keyframe.
START_STEPS = 3


@dataclass(frozen=True)
class TimingSearchResult:
    """The timing that fits best, as a correction of what the frames tell.

    Attributes:
        mean: (2,) readout and delay, s.
        sigmas_s: (2,) standard deviations.
        score_gain: By how much the best hypothesis fits better than no correction.
        best: That hypothesis.
    """

    mean: Array
    sigmas_s: Array
    score_gain: float
    best: "TimingHypothesis"

    @property
    def is_clear(self) -> bool:
        """Whether no correction is clearly wrong; else frames hardly tell timings apart."""
        return self.score_gain > MIN_SEARCH_SCORE_GAIN

    @property
    def is_certain(self) -> bool:
        """Whether no correction is certainly wrong, so that no more frames are needed."""
        return self.score_gain > SUFFICIENT_SEARCH_SCORE_GAIN


def needs_search(sigmas_s: Array) -> bool:
    """Whether a timing is too uncertain to start with."""
    return bool((sigmas_s > MAX_CALIBRATION_SIGMAS[:2]).any())


@dataclass(frozen=True)
class SearchedFrame:
    """A frame and its image pyramid, with the focal length in use.

    Attributes:
        told: What the frame tells.
        frame: The frame with the focal length in use.
        images: Its image pyramid.
        focal: Logarithm of the ratio of that focal length to that of the frame.
    """

    told: ToldFrame
    frame: RgbdFrame
    images: ImagePyramid
    focal: float

    @classmethod
    def of(
        cls, told: ToldFrame, focal: float, tracked: ImagePyramid | None = None
    ) -> "SearchedFrame":
        """Make it from a frame, without what has been learned of the light.

        Args:
            told: The frame.
            focal: Logarithm of the ratio of the focal length in use to that of the frame.
            tracked: Its image pyramid, if the tracker has built it.
        """
        frame = told.with_correction(np.array([0.0, 0.0, focal]))
        images = tracked or build_image_pyramid(frame)
        images = replace(images, vignetting=0.0, brightness_weight=BRIGHTNESS_WEIGHT)
        return cls(told, frame, images, focal)

    def with_timing(self, timing: Array) -> ImagePyramid:
        """Return the image pyramid with a timing corrected by (2,) s."""
        return replace(self.images, shutter=corrected_shutter(self.told.timing, timing))


class TimingHypothesis:
    """A timing, and a small tracker that uses it.

    Args:
        correction: (2,) of what the frames tell, s.
        first: The first frame.
        keyframe: It as a keyframe of a camera at rest.

    Attributes:
        correction: See above.
        keyframe: The keyframe, after the second frame with the camera's velocity.
        motion_state: At the last tracked frame.
        scores: Of each frame but the first: its negative log-likelihood; zero if tracking failed.
    """

    def __init__(self, correction: Array, first: SearchedFrame, keyframe: DirectKeyframe) -> None:
        images = first.with_timing(correction)
        self.correction = correction
        self.keyframe = replace(keyframe, images=images)
        self.motion_state = MotionState.at_rest(keyframe.T_world_keyframe, images)
        self.scores: list[float] = []
        self._views = [self._view(first, keyframe.T_world_keyframe)]

    @property
    def steps_to_next(self) -> int:
        """Steps that the next frame costs."""
        return 1 if len(self._views) > 1 else START_STEPS

    @property
    def velocity_of_first(self) -> Array:
        """(6,) twist of the camera at the first frame, in its own axes, m/s and rad/s."""
        views = self._views[:NUM_FIRST_VELOCITY_POSES]
        if len(views) < NUM_FIRST_VELOCITY_POSES:
            return self.keyframe.motion[:ACCELERATION_START]
        return velocity_at(views, 0)

    def track(self, frame: SearchedFrame) -> None:
        """Align the next frame with the keyframe."""
        images, state = frame.with_timing(self.correction), self.motion_state
        prior = state.motion_prior(self.keyframe.T_world_keyframe, images.stamp_s)
        alignment = align(
            self.keyframe.points,
            images,
            state.predict_alignment(self.keyframe.T_world_keyframe, images.stamp_s),
            prior,
            state.predict_gain(images, self.keyframe.images),
            uniform_weights(),
        )
        if rejection_reason(alignment):
            self.scores.append(0.0)
            return
        result = TrackingResult(self.keyframe, alignment, prior)
        if len(self._views) == 1:
            result = rebuild_first_keyframe(result, images, state, SEARCHED_CELLS)
            self.keyframe = result.keyframe
        self.motion_state = state.advance(
            result.T_world_camera,
            result.alignment.camera_velocity,
            images,
            result.alignment.gain,
            state.normalized_innovation,
            images.stamp_s,
        )
        self.scores.append(result.negative_log_likelihood)
        self._views.append(self._view(frame, result.T_world_camera))

    def _view(self, frame: SearchedFrame, T_world_camera: Array) -> TrackedView:
        calibration = np.append(self.correction, frame.focal)
        return TrackedView(frame.images.stamp_s, frame.told.timing, calibration, T_world_camera)


class TimingSearch:
    """Tracks frames with several timings, and compares their residuals.

    Args:
        first: The first frame; the camera moves.
        T_world_first: 4x4 pose at it.
        sigmas_s: (2,) standard deviations of the timing that the frames tell.

    Attributes:
        first: See above.
        T_world_first: See above.
        frames: The frames after the first one.
        hypotheses: The timings that are compared, no correction first.
    """

    def __init__(self, first: SearchedFrame, T_world_first: Array, sigmas_s: Array) -> None:
        self._sigmas_s = sigmas_s
        self.frames: list[SearchedFrame] = []
        # Of a camera at rest it is the same for each timing.
        keyframe = make_keyframe(
            first.frame, first.images, T_world_first, zero_motion(), SEARCHED_CELLS
        )
        self.first, self.T_world_first = first, T_world_first
        self.hypotheses = [
            TimingHypothesis(correction, first, keyframe)
            for correction in _make_corrections(first.told.timing, sigmas_s)
        ]

    @property
    def num_compared(self) -> int:
        """Number of frames that all trackers have processed."""
        return min(len(hypothesis.scores) for hypothesis in self.hypotheses)

    @property
    def is_complete(self) -> bool:
        """Whether no more frames are needed."""
        return self.num_compared >= NUM_SEARCHED_FRAMES - 1

    def add(self, frame: SearchedFrame) -> None:
        """Add a frame, and take up to `MAX_SEARCH_STEPS_PER_FRAME` steps of the trackers."""
        self.frames.append(frame)
        steps = MAX_SEARCH_STEPS_PER_FRAME
        while True:
            slowest = min(self.hypotheses, key=lambda hypothesis: len(hypothesis.scores))
            count = len(slowest.scores)
            steps -= slowest.steps_to_next
            if count == len(self.frames) or steps < 0:
                return
            slowest.track(self.frames[count])

    def evaluate(self) -> TimingSearchResult:
        """Return the timing by the frames that all trackers have processed."""
        corrections = np.array([hypothesis.correction for hypothesis in self.hypotheses])
        count = self.num_compared
        scores = np.array([sum(hypothesis.scores[:count]) for hypothesis in self.hypotheses])
        scores = (scores - scores.min()) / SEARCH_SCORE_SCALE
        scores += 0.5 * np.square(corrections / np.maximum(self._sigmas_s, 1e-9)).sum(axis=1)
        weights = np.exp(scores.min() - scores)
        weights /= weights.sum()
        mean = weights @ corrections
        spread = weights @ np.square(corrections - mean)
        sigmas_s = np.minimum(np.sqrt(spread + np.square(SEARCH_SIGMAS_S)), self._sigmas_s)
        return TimingSearchResult(
            mean,
            sigmas_s,
            score_gain=float(scores[0] - scores.min()),
            best=self.hypotheses[int(np.argmin(scores))],
        )


def _make_corrections(told: Array, sigmas_s: Array) -> Array:
    """(N, 2) corrections to try of the values that are uncertain, the first one zero."""
    is_uncertain = sigmas_s > MAX_CALIBRATION_SIGMAS[:2]
    readout_step, delay_step = np.where(is_uncertain, SEARCH_STEPS_S, 0.0)
    # A readout is never negative.
    readouts = (0.0, readout_step, 2.0 * readout_step if told[0] < readout_step else -readout_step)
    pairs = [(r, d) for r in readouts for d in (0.0, delay_step, -delay_step)]
    return np.array(list(dict.fromkeys(pairs)))
