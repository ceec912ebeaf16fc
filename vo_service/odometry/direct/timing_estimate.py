"""Estimate of the sensor's timing from the normal equations of many views.

All timings here are corrections (2,) in s of what the frames tell: of the readout time, and of the
delay of depth after color.
"""

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct.parameters import (
    CONTRADICTION_SIGMAS,
    INITIAL_VIEW_ERROR,
    INITIAL_VIEWS,
    INSTANT_TIMING_BAND_S,
    INSTANT_TIMING_SIGMAS,
    KEYFRAME_TIMING_SIGMAS_S,
    LINEAR_RANGE_PX,
    MAX_TIMING_SIGMAS_S,
    MIN_TIMING_CHANGE_SIGMAS,
    MIN_TIMING_CHANGES_S,
    MIN_TIMING_VIEWS,
    MIN_VIEW_ERROR,
    TIMING_DECAY,
    TIMING_RADIUS_PX,
    VIEW_DEGREES_OF_FREEDOM,
    VIEW_ERROR_DECAY,
)

_SHARED_COVARIANCE = np.diag(np.square(KEYFRAME_TIMING_SIGMAS_S))
_SPEED_DECAY = 0.95


class TimingEstimator:
    """Information about the timing, summed over keyframes, and the timing in use.

    The views of one keyframe share its errors, so their information is summed first and then
    limited. Views whose errors are large for their information weigh less (Student's t).

    Args:
        mean: (2,) timing before any view.
        sigmas_s: (2,) standard deviations of `mean`.
        in_use: (2,) timing in use before any view.
        instant: (2,) timing that makes the shutter instantaneous and the delay zero.
    """

    def __init__(self, mean: Array, sigmas_s: Array, in_use: Array, instant: Array) -> None:
        self.in_use = in_use
        self.estimate = mean
        self.sigmas_s = sigmas_s
        self._mean, self._prior_information = mean, np.diag(sigmas_s**-2.0)
        self._instant = instant
        # Of all former keyframes, then of the views of the current one.
        self._information, self._vector = np.zeros((2, 2)), np.zeros(2)
        self._view_information, self._view_vector = np.zeros((2, 2)), np.zeros(2)
        self._keyframe_stamp_s = np.nan
        self._view_error, self._view_count, self._views = 0.0, 0.0, 0
        self._squared_speed = 0.0

    def add(self, keyframe_stamp_s: float, speed: float, A: Array, b: Array) -> bool:
        """Add a view; return whether the timing in use has changed.

        Args:
            keyframe_stamp_s: Stamp of the view's keyframe.
            speed: Of the camera, rad/s.
            A: (2, 2) information.
            b: (2,) such that A x = b at the best timing x.
        """
        self._squared_speed = (
            _SPEED_DECAY * self._squared_speed + (1.0 - _SPEED_DECAY) * speed**2
            if self._views
            else speed**2
        )
        weight = self._weigh(A, b)
        if keyframe_stamp_s != self._keyframe_stamp_s:
            self.finish_keyframe()
            self._keyframe_stamp_s = keyframe_stamp_s
        self._view_information += weight * A
        self._view_vector += weight * b
        self._views += 1
        information, vector = self._from_frames()
        total = information + self._prior_information
        estimate: Array = np.linalg.inv(total) @ (vector + self._prior_information @ self._mean)
        self.estimate = estimate
        self.sigmas_s = np.sqrt(np.diag(np.linalg.inv(total)))
        return self._update_in_use()

    def finish_keyframe(self) -> None:
        """Add the information of the current keyframe's views to that of the former ones."""
        information, vector = self._limit_view_information()
        self._information = TIMING_DECAY * self._information + information
        self._vector = TIMING_DECAY * self._vector + vector
        self._view_information, self._view_vector = np.zeros((2, 2)), np.zeros(2)

    @property
    def is_certain(self) -> bool:
        """Whether the estimate is good enough to be used."""
        return self._views >= MIN_TIMING_VIEWS and bool((self.sigmas_s < MAX_TIMING_SIGMAS_S).all())

    def contradiction(self) -> Array | None:
        """(2,) timing by the frames alone, if it is far from the one before any view."""
        information, vector = self._from_frames()
        eigenvalues = np.linalg.eigvalsh(information)
        if self._views < MIN_TIMING_VIEWS or eigenvalues[0] <= 1e-9 * eigenvalues[1]:
            return None
        by_frames: Array = np.linalg.inv(information) @ vector
        covariance = np.linalg.inv(information) + np.linalg.inv(self._prior_information)
        off = np.abs(by_frames - self._mean) / np.sqrt(np.diag(covariance))
        return by_frames if (off > CONTRADICTION_SIGMAS).any() else None

    def _weigh(self, A: Array, b: Array) -> float:
        """Weight of a view by its squared error, which the usual one is updated with."""
        if self._views <= INITIAL_VIEWS:
            return 1.0
        off = np.linalg.solve(A + 1e-9 * np.trace(A) * np.eye(2), b) - self.estimate
        error = float(off @ A @ off) / len(off)
        degrees = VIEW_DEGREES_OF_FREEDOM
        weight = (degrees + 2.0) / (degrees + 2.0 * error / self._usual_error())
        self._view_error = VIEW_ERROR_DECAY * self._view_error + weight * error
        self._view_count = VIEW_ERROR_DECAY * self._view_count + 1.0
        return weight

    def _usual_error(self) -> float:
        total = self._view_error + INITIAL_VIEWS * INITIAL_VIEW_ERROR
        return max(total / (self._view_count + INITIAL_VIEWS), MIN_VIEW_ERROR)

    def _limit_view_information(self) -> tuple[Array, Array]:
        """Information of the current keyframe's views; the error that they share is added."""
        error = self._usual_error()
        A, b = self._view_information / error, self._view_vector / error
        gain = np.linalg.inv(np.eye(2) + A @ _SHARED_COVARIANCE)
        return gain @ A, gain @ b

    def _from_frames(self) -> tuple[Array, Array]:
        information, vector = self._limit_view_information()
        return self._information + information, self._vector + vector

    def _update_in_use(self) -> bool:
        if not self.is_certain:
            return False
        target = self._target()
        change = np.abs(target - self.in_use)
        if not (
            change > np.maximum(MIN_TIMING_CHANGES_S, MIN_TIMING_CHANGE_SIGMAS * self.sigmas_s)
        ).any():
            return False
        # Residuals are linear in the timing for a short way only.
        flow_px = TIMING_RADIUS_PX * np.sqrt(self._squared_speed) * max(change[0] / 3.0, change[1])
        keep = np.exp(-((flow_px / LINEAR_RANGE_PX) ** 2))
        self._information, self._vector = keep * self._information, keep * self._vector
        self._view_information = keep * self._view_information
        self._view_vector = keep * self._view_vector
        self.in_use = target
        return True

    def _target(self) -> Array:
        """Return the timing to use: exactly instantaneous if the estimate is close to that."""
        band = np.array(INSTANT_TIMING_BAND_S)
        if (self.in_use == self._instant).all():
            band = np.maximum(band, INSTANT_TIMING_SIGMAS * self.sigmas_s)
        if (np.abs(self.estimate - self._instant) < band).all():
            return self._instant
        return np.array([max(self.estimate[0], self._instant[0]), self.estimate[1]])
