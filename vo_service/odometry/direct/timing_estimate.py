"""Estimate of the sensor's timing from the normal equations of many views.

All timings here are corrections (2,) in s of what the frames tell: of the readout time, and of the
delay of depth after color. Information is a (2, 3) array [A b] with A x = b at the best timing x.
"""

from collections import deque
from math import exp, sqrt

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.parameters import (
    CONTRADICTION_SIGMAS,
    FORGOTTEN_TIMING_SIGMAS_S,
    INITIAL_VIEW_ERROR,
    INITIAL_VIEW_ERROR_VIEWS,
    INSTANT_TIMING_BAND_S,
    INSTANT_TIMING_SIGMAS,
    KEYFRAME_TIMING_SIGMAS_S,
    LINEAR_RANGE_PX,
    MAX_IMPOSSIBLE_SIGMAS,
    MAX_TIMING_S,
    MAX_TIMING_SIGMAS_S,
    MIN_CHANGED_KEYFRAMES,
    MIN_TIMING_CHANGE_SIGMAS,
    MIN_TIMING_CHANGES_S,
    MIN_TIMING_VIEWS,
    MIN_VIEW_ERROR,
    NUM_RECENT_TIMING_KEYFRAMES,
    SETTLED_TIMING_SIGMAS_S,
    TIMING_CHANGE_SIGMAS,
    TIMING_DECAY,
    TIMING_RADIUS_PX,
    TIMING_SPEED_DECAY,
    UNWEIGHTED_VIEWS,
    VIEW_DEGREES_OF_FREEDOM,
    VIEW_ERROR_DECAY,
)

ZERO = np.zeros((2, 3))
SHARED_VARIANCES = np.square(KEYFRAME_TIMING_SIGMAS_S)
# Added to the diagonal of an information before it is inverted, relative to its trace, and 1/s^2.
RELATIVE_REGULARIZATION, REGULARIZATION = 1e-9, 1e-3


class TimingEstimator:
    """Information about the timing, summed over keyframes, and the timing in use.

    The views of one keyframe share its errors, so their information is summed first and then
    limited. Views whose errors are large for their information weigh less (Student's t). If the
    last keyframes contradict all that was known before, it is forgotten: the timing has changed.

    Args:
        mean: (2,) timing before any view.
        sigmas_s: (2,) standard deviations of `mean`.
        in_use: (2,) timing in use before any view.
        instant: (2,) timing that makes the shutter instantaneous and the delay zero.

    Attributes:
        in_use: (2,) timing in use.
        estimate: (2,) timing by all views and the prior.
        sigmas_s: (2,) its standard deviations.
        is_certain: Whether the estimate is good enough to be used.
        contradiction: (2,) timing by the frames alone, if it is certain and far from `mean`.
    """

    def __init__(self, mean: Array, sigmas_s: Array, in_use: Array, instant: Array) -> None:
        self.in_use = in_use
        self.estimate = mean
        self.sigmas_s = sigmas_s
        self._told = _prior_information(mean, sigmas_s)
        self._instant = instant
        # Before any view; of older keyframes; of the last ones; of the views of the current one.
        self._prior, self._older, self._current = self._told, np.zeros((2, 3)), np.zeros((2, 3))
        self._recent: deque[Array] = deque()
        self._keyframe_stamp_s = np.nan
        self._view_error, self._view_count, self._views = 0.0, 0.0, 0
        self._squared_speed = 0.0
        self.is_certain = False
        self.contradiction: Array | None = None

    @property
    def is_settled(self) -> bool:
        """Whether the estimate is so good that few of the views are enough."""
        return _are_below(self.sigmas_s, SETTLED_TIMING_SIGMAS_S)

    def add(self, keyframe_stamp_s: float, speed: float, view: Array) -> bool:
        """Add a view; return whether the timing in use has changed.

        Args:
            keyframe_stamp_s: Stamp of the view's keyframe.
            speed: Of the camera, rad/s.
            view: (2, 3) information.
        """
        decay = TIMING_SPEED_DECAY if self._views else 0.0
        self._squared_speed = decay * self._squared_speed + (1.0 - decay) * speed**2
        weight = self._weigh(view)
        if keyframe_stamp_s != self._keyframe_stamp_s:
            self._finish_keyframe()
            self._keyframe_stamp_s = keyframe_stamp_s
        self._current += weight * view
        self._views += 1
        from_frames = self._from_frames()
        self.estimate, covariance = solve_information(self._prior + from_frames)
        self.sigmas_s = sigmas(covariance)
        self.is_certain = self._views >= MIN_TIMING_VIEWS and _are_below(
            self.sigmas_s, MAX_TIMING_SIGMAS_S
        )
        has_changed = self._update_in_use()
        self.contradiction = self._contradiction(
            self._from_frames() if has_changed else from_frames
        )
        return has_changed

    def _contradiction(self, from_frames: Array) -> Array | None:
        if not self.is_certain:
            return None
        if squared_disagreement(from_frames, self._told) <= CONTRADICTION_SIGMAS**2:
            return None
        by_frames, covariance = solve_information(from_frames)
        return by_frames if _are_below(sigmas(covariance), MAX_TIMING_SIGMAS_S) else None

    def _weigh(self, view: Array) -> float:
        """Weight of a view by its squared error, which the usual one is updated with."""
        if self._views <= UNWEIGHTED_VIEWS:
            return 1.0
        error = squared_error(view, self.estimate)
        degrees = VIEW_DEGREES_OF_FREEDOM
        weight = (degrees + 2.0) / (degrees + 2.0 * error / self._usual_error())
        self._view_error = VIEW_ERROR_DECAY * self._view_error + weight * error
        self._view_count = VIEW_ERROR_DECAY * self._view_count + 1.0
        return weight

    def _usual_error(self) -> float:
        total = self._view_error + INITIAL_VIEW_ERROR_VIEWS * INITIAL_VIEW_ERROR
        return max(total / (self._view_count + INITIAL_VIEW_ERROR_VIEWS), MIN_VIEW_ERROR)

    def _finish_keyframe(self) -> None:
        """Add the information of the current keyframe's views to that of the last keyframes."""
        self._scale(TIMING_DECAY)
        finished = limit_information(self._current, self._usual_error())
        self._current = np.zeros((2, 3))
        if not self._is_possible(finished):
            return
        self._recent.append(finished)
        self._forget_if_changed()
        if len(self._recent) > NUM_RECENT_TIMING_KEYFRAMES:
            self._older = self._older + self._recent.popleft()

    def _is_possible(self, information: Array) -> bool:
        """Whether a timing may be that of a sensor; errors of another kind give other ones."""
        timing, covariance = solve_information(information)
        readout_s, delay_s = timing - (self._instant[0], 0.0)
        off_s = np.array(
            [max(-readout_s, readout_s - MAX_TIMING_S[0]), abs(delay_s) - MAX_TIMING_S[1]]
        )
        return bool((off_s <= MAX_IMPOSSIBLE_SIGMAS * sigmas(covariance)).all())

    def _forget_if_changed(self) -> None:
        """Forget what the last keyframes contradict, if several do; the change may be at any."""
        keyframes = list(self._recent)
        known = self._prior + self._older
        squared = [
            squared_disagreement(sum(keyframes[k:], ZERO), sum(keyframes[:k], known))
            for k in range(1, len(keyframes))
        ]
        by_several = squared[: max(len(keyframes) - MIN_CHANGED_KEYFRAMES, 0)]
        if max(by_several, default=0.0) > TIMING_CHANGE_SIGMAS**2:
            self._recent = deque(keyframes[1 + int(np.argmax(squared)) :])
            self._older = ZERO.copy()
            self._prior = _prior_information(self.in_use, np.array(FORGOTTEN_TIMING_SIGMAS_S))

    def _scale(self, factor: float) -> None:
        """Reduce the information from all former keyframes."""
        self._older = factor * self._older
        self._recent = deque(factor * information for information in self._recent)

    def _from_frames(self) -> Array:
        """(2, 3) information without the prior."""
        current = limit_information(self._current, self._usual_error())
        return np.asarray(self._older + current + sum(self._recent))

    def _update_in_use(self) -> bool:
        if not self.is_certain:
            return False
        target = self._target()
        change = np.abs(target - self.in_use).tolist()
        significant = (MIN_TIMING_CHANGE_SIGMAS * self.sigmas_s).tolist()
        if all(
            each <= max(least, by_sigma)
            for each, least, by_sigma in zip(change, MIN_TIMING_CHANGES_S, significant, strict=True)
        ):
            return False
        # Residuals are linear in the timing for a short way only.
        flow_px = TIMING_RADIUS_PX * sqrt(self._squared_speed) * max(change[0] / 3.0, change[1])
        keep = exp(-((flow_px / LINEAR_RANGE_PX) ** 2))
        self._scale(keep)
        self._current = keep * self._current
        self.in_use = target
        return True

    def _target(self) -> Array:
        """Return the timing to use: exactly instantaneous if the estimate is close to that."""
        band = INSTANT_TIMING_BAND_S
        instant, estimate = self._instant.tolist(), self.estimate.tolist()
        if self.in_use.tolist() == instant:
            band = tuple(map(max, band, (INSTANT_TIMING_SIGMAS * self.sigmas_s).tolist()))
        if all(
            abs(value - at) < width
            for value, at, width in zip(estimate, instant, band, strict=True)
        ):
            return self._instant
        return np.array([max(estimate[0], instant[0]), estimate[1]])


def _are_below(sigmas_s: Array, limits_s: tuple[float, float]) -> bool:
    """Whether the sigmas (2,) are smaller than their limits."""
    readout_s, delay_s = sigmas_s.tolist()
    return bool(readout_s < limits_s[0] and delay_s < limits_s[1])


def _prior_information(mean: Array, sigmas_s: Array) -> Array:
    """(2, 3) information of a timing with standard deviations."""
    A = np.diag(sigmas_s**-2.0)
    return np.column_stack([A, A @ mean])


@kernel
def solve_information(information: Array) -> tuple[Array, Array]:
    """(2,) best timing and its (2, 2) covariance, of an information (2, 3)."""
    small = RELATIVE_REGULARIZATION * (information[0, 0] + information[1, 1]) + REGULARIZATION
    covariance = _inverse(information[0, 0] + small, information[0, 1], information[1, 1] + small)
    # Not `@`: a kernel with it loads SciPy's linear algebra.
    a, b, d = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    first, second = information[0, 2], information[1, 2]
    return np.array([a * first + b * second, b * first + d * second]), covariance


@kernel
def sigmas(covariance: Array) -> Array:
    """(2,) standard deviations of a covariance (2, 2)."""
    return np.sqrt(np.diag(covariance))


@kernel
def squared_error(view: Array, timing: Array) -> float:
    """Mean squared error of a timing (2,) by the information (2, 3) of a view."""
    best, _ = solve_information(view)
    u, v = best - timing
    return float(u * (view[0, 0] * u + view[0, 1] * v) + v * (view[1, 0] * u + view[1, 1] * v)) / 2


@kernel
def limit_information(information: Array, error: float) -> Array:
    """(2, 3) information of a keyframe's views; the error that they share is added.

    Args:
        information: (2, 3) sum over the views.
        error: Usual squared error of a view, relative to its information.
    """
    # (I + A S)^-1 [A b], with S the covariance of the shared error.
    a = 1.0 + information[0, 0] / error * SHARED_VARIANCES[0]
    b = information[0, 1] / error * SHARED_VARIANCES[1]
    c = information[1, 0] / error * SHARED_VARIANCES[0]
    d = 1.0 + information[1, 1] / error * SHARED_VARIANCES[1]
    limited = np.empty((2, 3))
    for k in range(3):
        first, second = information[0, k] / error, information[1, k] / error
        limited[0, k] = (d * first - b * second) / (a * d - b * c)
        limited[1, k] = (a * second - c * first) / (a * d - b * c)
    return limited


@kernel
def squared_disagreement(one: Array, other: Array) -> float:
    """Squared difference, in its standard deviations, of the timings of two informations (2, 3)."""
    mean, covariance = solve_information(one)
    other_mean, other_covariance = solve_information(other)
    (u, v), total = mean - other_mean, covariance + other_covariance
    inverse = _inverse(total[0, 0], total[0, 1], total[1, 1])
    a, b, d = inverse[0, 0], inverse[0, 1], inverse[1, 1]
    return float(u * (a * u + b * v) + v * (b * u + d * v))


@kernel
def _inverse(a: float, b: float, d: float) -> Array:
    """Inverse (2, 2) of the symmetric matrix a, b; b, d."""
    inverse = np.empty((2, 2))
    scale = 1.0 / (a * d - b * b)
    inverse[0, 0], inverse[1, 1] = scale * d, scale * a
    inverse[0, 1] = inverse[1, 0] = -scale * b
    return inverse
