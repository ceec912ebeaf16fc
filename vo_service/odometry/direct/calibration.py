"""The sensor's calibration as one state, and the information filter that learns it.

The state has the readout time, the delay of depth after color and the logarithm of the focal
length, as corrections of what the frames tell, and the disagreement of depth with brightness about
the focal length. Information is a (4, 5) array [A b] with A x = b at the best state x.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import hypot

import numpy as np

from drivers.calibration import UNKNOWN_TIMING_SIGMAS_S
from drivers.core.geometry import Array
from vo_service.odometry.direct.calibration_equations import (
    DELAY,
    DISAGREEMENT,
    FOCAL,
    NUM_KEPT,
    READOUT,
    TIMING,
    USED,
    limit_information,
    solve_information,
)
from vo_service.odometry.direct.calibration_trial import CalibrationTrial
from vo_service.odometry.direct.parameters import (
    CALIBRATION_DECAY,
    CONTRADICTION_SIGMAS,
    FOCAL_NONLINEARITY,
    INITIAL_VIEW_ERROR,
    INITIAL_VIEW_ERROR_VIEWS,
    MAX_CALIBRATION_SIGMAS,
    MAX_IMPOSSIBLE_SIGMAS,
    MAX_TIMING_S,
    MIN_CALIBRATION_CHANGE_SIGMAS,
    MIN_CALIBRATION_CHANGES,
    MIN_CALIBRATION_VIEWS,
    MIN_CHANGED_KEYFRAMES,
    MIN_FOCAL_DISAGREEMENT_SHARE,
    NUM_RECENT_KEYFRAMES,
    SETTLED_CALIBRATION_SIGMAS,
    TIMING_CHANGE_SIGMAS,
    VIEW_ERROR_DECAY,
)
from vo_service.odometry.direct.small_matrices import invert_cholesky

ONLY_FOCAL = slice(FOCAL, FOCAL + 1)
# Sigma of the disagreement before any view: it is free.
FREE_SIGMA = 1.0


@dataclass(frozen=True)
class CalibrationPrior:
    """What is known before any view, and used from the first one on.

    Attributes:
        mean: (3,) readout and delay, s, and logarithm of the focal length.
        sigmas: (3,) standard deviations.
        unlearned: (3,) calibration without any learning.
        focal_source: Source of the focal length, see `OnlineFocalLength`.
    """

    mean: Array
    sigmas: Array
    unlearned: Array
    focal_source: str = "intrinsics"

    @property
    def information(self) -> Array:
        """(4, 5) information; the disagreement is free."""
        return _information_of(np.append(self.mean, 0.0), np.append(self.sigmas, FREE_SIGMA))


class CalibrationFilter:
    """Information about the calibration, summed over keyframes, and the calibration in use.

    The views of a keyframe share its errors, so their information is summed first and then limited.
    If the timing by the last keyframes contradicts all that was known before, the latter is
    forgotten: the timing has changed. Only brightness gives the focal length. The one in use is
    kept if brightness is not clearly further away from it than depth. Timing and focal length are
    used while frames fit better with them than without.

    Args:
        prior: What is known before any view.
        min_readout_s: Correction of the readout that makes it zero.

    Attributes:
        in_use: (3,) calibration in use.
        estimate: (3,) calibration by all views and the prior.
        sigmas: (3,) its standard deviations.
        disagreement: Focal length by depth minus that by brightness; None while unsure.
        focal_source: Source of the focal length in use, see `OnlineFocalLength`.
        is_certain: Whether the timing is known well enough to be used.
        contradiction: (2,) timing by the frames alone, if it is certain and far from the prior.
        timing_trial: Whether frames fit better with the timing.
        focal_trial: Whether frames fit better with the focal length.
    """

    def __init__(self, prior: CalibrationPrior, min_readout_s: float = 0.0) -> None:
        self.in_use = self.estimate = self._proposed = prior.mean
        # A timing that is no longer what the frames tell has been found by the fit of frames.
        self.timing_trial = CalibrationTrial(bool((prior.mean != prior.unlearned)[TIMING].any()))
        self.focal_trial = CalibrationTrial()
        self.sigmas = prior.sigmas
        self.disagreement: float | None = None
        self.focal_source = prior.focal_source
        self.is_certain = False
        self.contradiction: Array | None = None
        self._told, self._unlearned = prior.information, prior.unlearned
        self._min_readout_s, self._source_unlearned = min_readout_s, prior.focal_source
        # Before any view; of older keyframes; of the last ones; of the views of the current one.
        self._prior, self._older, self._current = prior.information, _nothing(), _nothing()
        self._recent: deque[Array] = deque()
        self._state = np.append(prior.mean, 0.0)
        self._keyframe_stamp_s = np.nan
        self._num_views = 0
        # Fading mean of the squared errors of views, relative to their information.
        self._view_error = INITIAL_VIEW_ERROR

    @property
    def is_settled(self) -> bool:
        """Whether the estimate is so good that few of the views are enough."""
        return bool((self.sigmas < SETTLED_CALIBRATION_SIGMAS).all())

    @property
    def _trials(self) -> tuple[tuple[slice, CalibrationTrial], ...]:
        return (TIMING, self.timing_trial), (ONLY_FOCAL, self.focal_trial)

    @property
    def is_tried(self) -> bool:
        """Whether enough frames have been compared to judge all that was learned."""
        is_learned = self._proposed != self._unlearned
        return all(trial.is_complete for part, trial in self._trials if is_learned[part].any())

    def add(self, keyframe_stamp_s: float, view: Array) -> bool:
        """Add a view; return whether the calibration in use has changed.

        Args:
            keyframe_stamp_s: Stamp of the view's keyframe.
            view: (4, 5) information.
        """
        if keyframe_stamp_s != self._keyframe_stamp_s:
            self._finish_keyframe()
            self._keyframe_stamp_s = keyframe_stamp_s
        self._current += view
        self._num_views += 1
        step = max(1.0 - VIEW_ERROR_DECAY, 1.0 / (self._num_views + INITIAL_VIEW_ERROR_VIEWS))
        self._view_error += step * (squared_error(view, self._state) - self._view_error)
        from_frames = (
            self._older + sum(self._recent) + limit_information(self._current, self._view_error)
        )
        self._state, covariance = solve_information(self._prior + from_frames)
        sigmas = np.sqrt(np.diag(covariance))
        self.estimate, self.sigmas = self._state[USED], sigmas[USED]
        is_certain = sigmas < MAX_CALIBRATION_SIGMAS
        self.is_certain = bool(is_certain[TIMING].all()) and (
            self._num_views >= MIN_CALIBRATION_VIEWS
        )
        self.disagreement = float(self._state[DISAGREEMENT]) if is_certain[FOCAL:].all() else None
        self.contradiction = self._find_contradiction(from_frames)
        if not self.is_certain:
            return False
        self._proposed = self._propose()
        return self._update_in_use()

    def compare(self, negative_log_likelihood: Callable[[Array], float]) -> None:
        """Compare the fit of a frame with and without what was learned; the next view applies it.

        Args:
            negative_log_likelihood: Of the frame, by a calibration (3,).
        """
        if not self.is_certain:
            return
        for part, trial in self._trials:
            without = self._proposed.copy()
            without[part] = self._unlearned[part]
            if (without != self._proposed).any():
                gain = negative_log_likelihood(without) - negative_log_likelihood(self._proposed)
                trial.add(gain)

    # -- keyframes -------------------------------------------------------------------------------
    def _finish_keyframe(self) -> None:
        """Add the information of the current keyframe's views to that of the last keyframes."""
        self._older = CALIBRATION_DECAY * self._older
        self._recent = deque(CALIBRATION_DECAY * each for each in self._recent)
        finished = limit_information(self._current, self._view_error)
        self._current = _nothing()
        if not self._is_possible(finished):
            return
        self._recent.append(finished)
        self._forget_if_changed()
        if len(self._recent) > NUM_RECENT_KEYFRAMES:
            self._older = self._older + self._recent.popleft()

    def _is_possible(self, keyframe: Array) -> bool:
        """Whether a timing may be that of a sensor; errors of another kind give other ones."""
        timing, covariance = solve_information(given_focal(keyframe, self._state))
        readout_s, delay_s = (timing - (self._min_readout_s, 0.0)).tolist()
        off_s = (
            max(-readout_s, readout_s - MAX_TIMING_S[READOUT]),
            abs(delay_s) - MAX_TIMING_S[DELAY],
        )
        return bool((off_s <= MAX_IMPOSSIBLE_SIGMAS * np.sqrt(np.diag(covariance))).all())

    def _forget_if_changed(self) -> None:
        """Forget the timing that the last keyframes contradict, if several do, from any on."""
        keyframes = list(self._recent)
        known = self._prior + self._older
        squared = [
            squared_disagreement(
                sum(keyframes[k:], _nothing()), sum(keyframes[:k], known), self._state
            )
            for k in range(1, len(keyframes))
        ]
        by_several = squared[: max(len(keyframes) - MIN_CHANGED_KEYFRAMES, 0)]
        if max(by_several, default=0.0) > TIMING_CHANGE_SIGMAS**2:
            self._recent = deque(keyframes[1 + int(np.argmax(squared)) :])
            self._older = _nothing()
            sigmas = np.array([*UNKNOWN_TIMING_SIGMAS_S, self.sigmas[FOCAL], FREE_SIGMA])
            self._prior = _information_of(np.append(self.in_use, 0.0), sigmas)

    def _find_contradiction(self, from_frames: Array) -> Array | None:
        if not self.is_certain:
            return None
        if squared_disagreement(from_frames, self._told, self._state) <= CONTRADICTION_SIGMAS**2:
            return None
        by_frames, covariance = solve_information(given_focal(from_frames, self._state))
        is_certain = np.sqrt(np.diag(covariance)) < MAX_CALIBRATION_SIGMAS[:2]
        return by_frames if is_certain.all() else None

    # -- the calibration in use ------------------------------------------------------------------
    def _propose(self) -> Array:
        """(3,) calibration by the estimate."""
        proposed, in_use = self.estimate.copy(), float(self.in_use[FOCAL])
        proposed[READOUT] = max(proposed[READOUT], self._min_readout_s)
        # Brightness is believed if it is clearly further away from the one in use than depth.
        focal, disagreement = float(proposed[FOCAL]), self.disagreement
        change = abs(focal - in_use)
        is_clear = disagreement is not None and change > max(
            MIN_CALIBRATION_CHANGES[FOCAL],
            MIN_CALIBRATION_CHANGE_SIGMAS[FOCAL] * float(self.sigmas[FOCAL]),
            MIN_FOCAL_DISAGREEMENT_SHARE * abs(disagreement),
        )
        proposed[FOCAL] = focal if is_clear else in_use
        return proposed

    def _update_in_use(self) -> bool:
        target = self._proposed.copy()
        if not self.timing_trial.is_accepted:
            target[TIMING] = self._unlearned[TIMING]
        if not self.focal_trial.is_accepted:
            target[FOCAL] = self._unlearned[FOCAL]
        change = np.abs(target - self.in_use)
        limits = np.array(MIN_CALIBRATION_CHANGE_SIGMAS) * self.sigmas
        # The trial has decided on a change to or from the unlearned values.
        is_decided = (target == self._unlearned) | (self.in_use == self._unlearned)
        is_changed = change > np.where(is_decided, 0.0, np.maximum(limits, MIN_CALIBRATION_CHANGES))
        if is_changed[FOCAL]:
            self._restart_focal(float(target[FOCAL]), float(change[FOCAL]))
        if not is_changed[TIMING].any():
            target[TIMING] = self.in_use[TIMING]
        if not is_changed[FOCAL]:
            target[FOCAL] = self.in_use[FOCAL]
        self.in_use = target
        return bool(is_changed.any())

    def _restart_focal(self, focal: float, change: float) -> None:
        """Use another focal length: residuals of the views so far are not linear in the change."""
        is_unlearned = focal == self._unlearned[FOCAL]
        self.focal_source = self._source_unlearned if is_unlearned else "learned"
        self.disagreement = None
        self._older, self._current, *recent = (
            _without_focal(each, self._state)
            for each in (self._older, self._current, *self._recent)
        )
        self._recent = deque(recent)
        sigma = hypot(float(self.sigmas[FOCAL]), FOCAL_NONLINEARITY * change)
        focal_only = _information_of(
            np.array([0.0, 0.0, focal, 0.0]), np.array([np.inf, np.inf, sigma, FREE_SIGMA])
        )
        self._prior = _without_focal(self._prior, self._state) + focal_only


def _nothing() -> Array:
    return np.zeros((NUM_KEPT, NUM_KEPT + 1))


def _information_of(mean: Array, sigmas: Array) -> Array:
    """(N, N + 1) information of a state (N,) with standard deviations (N,)."""
    A = np.diag(sigmas**-2.0)
    return np.column_stack([A, A @ mean])


def given_focal(information: Array, state: Array) -> Array:
    """(2, 3) information of the timing, given focal length and disagreement of a state (4,)."""
    A, b = information[TIMING, TIMING], information[TIMING, NUM_KEPT]
    return np.column_stack([A, b - information[TIMING, FOCAL:NUM_KEPT] @ state[FOCAL:]])


def squared_error(view: Array, state: Array) -> float:
    """Mean squared error of a view's timing, relative to its information (4, 5)."""
    timing = given_focal(view, state)
    mean, _ = solve_information(timing)
    difference = mean - state[TIMING]
    return max(0.5 * float(difference @ timing[:, :2] @ difference), 1.0)


def _without_focal(information: Array, state: Array) -> Array:
    """(4, 5) information of the timing alone, see `given_focal`."""
    timing = given_focal(information, state)
    alone = _nothing()
    alone[TIMING, TIMING], alone[TIMING, NUM_KEPT] = timing[:, :2], timing[:, 2]
    return alone


def squared_disagreement(one: Array, other: Array, state: Array) -> float:
    """Squared difference, in its standard deviations, of the timings of two informations (4, 5).

    Args:
        one: The first.
        other: The second.
        state: (4,) state whose focal length and disagreement are those of both.
    """
    mean, covariance = solve_information(given_focal(one, state))
    other_mean, other_covariance = solve_information(given_focal(other, state))
    difference = mean - other_mean
    inverse = invert_cholesky(covariance + other_covariance)
    return float(difference @ inverse @ difference)
