"""The sensor's calibration as one state, and the information filter that learns it.

The state has the readout time, the delay of depth after color and the logarithm of the focal
length, as corrections of what the frames tell, and the disagreement of depth with brightness about
the focal length. Information is a (4, 5) array [A b] with A x = b at the best state x.
"""

from collections import deque
from collections.abc import Callable

import numpy as np

from drivers.calibration import UNKNOWN_TIMING_SIGMAS_S
from drivers.core.geometry import Array
from vo_service.odometry.direct.calibration_equations import (
    DISAGREEMENT,
    FOCAL,
    NUM_KEPT,
    READOUT,
    TIMING,
    USED,
    estimate_calibration,
    given_focal,
    limit_information,
    solve_information,
    squared_error,
)
from vo_service.odometry.direct.parameters import (
    CALIBRATION_CHANGE_SIGMAS,
    CALIBRATION_DECAY,
    INITIAL_VIEW_ERROR,
    MAX_CALIBRATION_SIGMAS,
    MIN_CALIBRATION_CHANGES,
    MIN_TRIAL_GAIN,
    NUM_RECENT_KEYFRAMES,
    NUM_TRIAL_FRAMES,
    VIEW_ERROR_DECAY,
)
from vo_service.odometry.direct.small_matrices import invert_cholesky


class CalibrationTrial:
    """Whether the last frames fit better with a learned value than without it.

    Attributes:
        is_accepted: Whether the value is used; it may be before any frame.
    """

    def __init__(self, is_accepted: bool) -> None:
        self.is_accepted = is_accepted
        self._gains: deque[float] = deque(maxlen=NUM_TRIAL_FRAMES)

    @property
    def is_complete(self) -> bool:
        """Whether enough frames have been compared."""
        return len(self._gains) == NUM_TRIAL_FRAMES

    @property
    def is_refused(self) -> bool:
        """Whether the frames fit no better with it."""
        return self.is_complete and not self.is_accepted

    def add(self, gain: float) -> None:
        """Add by how much the negative log-likelihood of a frame is lower with the value."""
        self._gains.append(gain)
        if self.is_complete:
            # A value in use stays while it does not harm, so that it does not alternate.
            min_gain = 0.0 if self.is_accepted else MIN_TRIAL_GAIN
            self.is_accepted = sum(self._gains) > min_gain * NUM_TRIAL_FRAMES


class CalibrationFilter:
    """Information about the calibration, summed over keyframes, and the calibration in use.

    The views of a keyframe share its errors, so their information is summed first and then limited.
    If the timing by the last keyframes contradicts all that was known before, the latter is
    forgotten: the timing has changed. Only brightness gives the focal length. Timing and focal
    length are used while frames fit better with them than without.

    Args:
        mean: (3,) calibration before any view: readout and delay, s, and logarithm of the focal
            length. It is used from the first view on.
        sigmas: (3,) its standard deviations.
        unlearned: (3,) calibration without any learning.
        min_readout_s: Correction of the readout that makes it zero.

    Attributes:
        in_use: (3,) calibration in use.
        estimate: (3,) calibration by all views and the prior.
        sigmas: (3,) its standard deviations.
        disagreement: Focal length by depth minus that by brightness; None while unsure.
        is_certain: Whether the timing is known well enough to be used.
        contradiction: (2,) timing by the frames alone, if it is certain and far from the prior.
        timing_trial: Whether frames fit better with the timing.
        focal_trial: Whether frames fit better with the focal length.
    """

    def __init__(
        self, mean: Array, sigmas: Array, unlearned: Array, min_readout_s: float = 0.0
    ) -> None:
        self.in_use = self.estimate = self._proposed = mean
        self.sigmas = sigmas
        self.disagreement: float | None = None
        self.is_certain = False
        self.contradiction: Array | None = None
        # A timing that is no longer what the frames tell has been found by the fit of frames.
        self.timing_trial = CalibrationTrial(bool((mean != unlearned)[TIMING].any()))
        self.focal_trial = CalibrationTrial(is_accepted=False)
        self._parts = (TIMING, self.timing_trial), (slice(FOCAL, FOCAL + 1), self.focal_trial)
        self._unlearned, self._min_readout_s = unlearned, min_readout_s
        # Before any view; of older keyframes; of the last ones; of the views of the current one.
        self._told = self._prior = _information_of(mean, sigmas)
        self._older, self._current = _nothing(), _nothing()
        self._recent: list[Array] = []
        self._from_keyframes = _nothing()
        self._keyframe_stamp_s = np.nan
        self._state = np.append(mean, 0.0)
        # Fading mean of the squared errors of views, relative to their information.
        self._view_error = INITIAL_VIEW_ERROR

    @property
    def errors(self) -> Array:
        """(3,) root mean square error of the calibration in use."""
        return np.hypot(self.sigmas, self.estimate - self.in_use)

    @property
    def is_focal_learned(self) -> bool:
        """Whether the focal length in use has been learned."""
        return bool(self.in_use[FOCAL] != self._unlearned[FOCAL])

    @property
    def is_tried(self) -> bool:
        """Whether something was learned, and enough frames have been compared to judge it."""
        is_learned = self._proposed != self._unlearned
        trials = [trial for part, trial in self._parts if is_learned[part].any()]
        return bool(trials) and all(trial.is_complete for trial in trials)

    def add(self, keyframe_stamp_s: float, view: Array) -> bool:
        """Add a view; return whether the calibration in use has changed.

        Args:
            keyframe_stamp_s: Stamp of the view's keyframe.
            view: (4, 5) information.
        """
        if keyframe_stamp_s != self._keyframe_stamp_s:
            self._finish_keyframe()
            self._keyframe_stamp_s = keyframe_stamp_s
        error = squared_error(view, self._state)
        self._view_error += (1.0 - VIEW_ERROR_DECAY) * (error - self._view_error)
        self._current += view
        known = self._prior + self._from_keyframes
        self._state, sigmas = estimate_calibration(known, self._current, self._view_error)
        self.estimate, self.sigmas = self._state[USED], sigmas[USED]
        is_certain = (sigmas < MAX_CALIBRATION_SIGMAS).tolist()
        self.is_certain = all(is_certain[TIMING])
        self.disagreement = float(self._state[DISAGREEMENT]) if all(is_certain[FOCAL:]) else None
        if not self.is_certain:
            return False
        self._proposed, before = self._propose(), self.in_use
        self.in_use = self._proposed.copy()
        for part, trial in self._parts:
            if not trial.is_accepted:
                self.in_use[part] = self._unlearned[part]
        return bool((self.in_use != before).any())

    def compare(self, negative_log_likelihood: Callable[[Array], float]) -> None:
        """Compare the fit of a frame with and without what was learned; the next view applies it.

        Args:
            negative_log_likelihood: Of the frame, by a calibration (3,).
        """
        if not self.is_certain:
            return
        with_all: float | None = None
        for part, trial in self._parts:
            without = self._proposed.copy()
            without[part] = self._unlearned[part]
            if (without != self._proposed).any():
                if with_all is None:
                    with_all = negative_log_likelihood(self._proposed)
                trial.add(negative_log_likelihood(without) - with_all)

    def _propose(self) -> Array:
        """(3,) calibration by the estimate; the one in use where it is not clearly another."""
        proposed = self.estimate.copy()
        proposed[READOUT] = max(proposed[READOUT], self._min_readout_s)
        limits = np.maximum(MIN_CALIBRATION_CHANGES, self.sigmas)
        if self.disagreement is None:
            limits[FOCAL] = np.inf
        is_clear = np.abs(proposed - self.in_use) > limits
        is_clear[TIMING] = is_clear[TIMING].any()
        return np.where(is_clear, proposed, self.in_use)

    # -- keyframes -------------------------------------------------------------------------------
    def _finish_keyframe(self) -> None:
        """Add the information of the current keyframe's views to that of the last keyframes."""
        finished = limit_information(self._current, self._view_error)
        self._current = _nothing()
        self._recent.append(finished)
        self._older = CALIBRATION_DECAY * self._older
        if len(self._recent) > NUM_RECENT_KEYFRAMES:
            self._older += self._recent.pop(0)
        recent = sum(self._recent, _nothing())
        if len(self._recent) == NUM_RECENT_KEYFRAMES and self._differ(
            recent, self._prior + self._older
        ):
            # The timing has changed; the first of them may still be of the one before.
            recent -= self._recent.pop(0)
            self._older = _nothing()
            sigmas = np.array([*UNKNOWN_TIMING_SIGMAS_S, self.sigmas[FOCAL]])
            self._prior = _information_of(self.in_use, sigmas)
        self._from_keyframes = self._older + recent
        self.contradiction = self._find_contradiction()

    def _differ(self, one: Array, other: Array) -> bool:
        """Whether the timings of two informations differ, given the focal length."""
        timing, covariance = solve_information(given_focal(one, self._state))
        other_timing, other_covariance = solve_information(given_focal(other, self._state))
        difference = timing - other_timing
        inverse = invert_cholesky(covariance + other_covariance)
        return float(difference @ inverse @ difference) > CALIBRATION_CHANGE_SIGMAS**2

    def _find_contradiction(self) -> Array | None:
        if not self._differ(self._from_keyframes, self._told):
            return None
        timing, covariance = solve_information(given_focal(self._from_keyframes, self._state))
        is_certain = np.sqrt(np.diag(covariance)) < MAX_CALIBRATION_SIGMAS[TIMING]
        return timing if is_certain.all() else None


def _nothing() -> Array:
    return np.zeros((NUM_KEPT, NUM_KEPT + 1))


def _information_of(mean: Array, sigmas: Array) -> Array:
    """(4, 5) information of a calibration (3,) with standard deviations (3,).

    The disagreement is nearly free.
    """
    A = np.diag([*sigmas**-2.0, 1.0])
    return np.column_stack([A, A @ np.append(mean, 0.0)])
