"""Estimate of the color camera's focal length from the normal equations of many views.

Focal lengths are logarithms of the ratio to that of the frames. Information is a (2, 2) array, by
brightness and by depth: A and the product A x with the best focal length x.
"""

from math import hypot, sqrt

import numpy as np

from drivers.core.geometry import Array
from vo_service.odometry.direct.focal_equations import BY_BRIGHTNESS
from vo_service.odometry.direct.parameters import (
    FOCAL_DECAY,
    FOCAL_NONLINEARITY,
    FOCAL_PRIOR_SIGMA,
    FOCAL_STEP_RATIO,
    FOCAL_VIEW_ERROR,
    KEYFRAME_FOCAL_SIGMA,
    MAX_FOCAL_CORRECTION,
    MAX_FOCAL_SIGMAS,
    MIN_FOCAL_CHANGE,
    MIN_FOCAL_CHANGE_SIGMAS,
    MIN_FOCAL_DISAGREEMENT_SHARE,
)


class FocalEstimator:
    """Information about the focal length, summed over keyframes, and the focal length in use.

    Brightness alone gives the estimate. Depth is only compared with it: the focal length in use is
    kept if brightness is not clearly further away from it than depth.

    Attributes:
        in_use: Focal length in use.
        estimate: Focal length by the prior and brightness.
        sigma: Its standard deviation.

    Args:
        prior: Focal length in use at the start.
        prior_sigma: Its standard deviation.
    """

    def __init__(self, prior: float = 0.0, prior_sigma: float = FOCAL_PRIOR_SIGMA) -> None:
        self.in_use = self.estimate = prior
        self.sigma = prior_sigma
        self._prior = (prior, prior_sigma)
        # Of former keyframes; of the views of the current one.
        self._former, self._current = np.zeros((2, 2)), np.zeros((2, 2))
        self._keyframe_stamp_s = np.nan

    def add(self, keyframe_stamp_s: float, view: Array) -> bool:
        """Add a view; return whether the focal length in use has changed.

        Args:
            keyframe_stamp_s: Stamp of the view's keyframe.
            view: (2, 2) information of the view about the change of the one in use.
        """
        if keyframe_stamp_s != self._keyframe_stamp_s:
            self._former = FOCAL_DECAY * self._from_views()
            self._current = np.zeros((2, 2))
            self._keyframe_stamp_s = keyframe_stamp_s
        A, b = FOCAL_STEP_RATIO * view[:, 0], view[:, 1]
        self._current += np.column_stack([A, b + A * self.in_use])
        mean, sigma = self._prior
        information, product = self._from_views()[BY_BRIGHTNESS].tolist()
        self.sigma = 1.0 / sqrt(information + sigma**-2.0)
        self.estimate = (product + mean * sigma**-2.0) * self.sigma**2
        return self._update_in_use()

    @property
    def disagreement(self) -> tuple[float, float] | None:
        """Focal length by depth minus that by brightness, and its sigma; None while unsure."""
        A, b = self._from_views().T
        if (A * np.square(MAX_FOCAL_SIGMAS) < 1.0).any():
            return None
        by_brightness, by_depth = (b / A).tolist()
        return by_depth - by_brightness, sqrt((1.0 / A).sum())

    def _from_views(self) -> Array:
        """(2, 2) information without the prior; views of one keyframe share an error."""
        A = self._current[:, :1]
        return self._former + self._current / (FOCAL_VIEW_ERROR + KEYFRAME_FOCAL_SIGMA**2 * A)

    def _update_in_use(self) -> bool:
        target = min(max(self.estimate, -MAX_FOCAL_CORRECTION), MAX_FOCAL_CORRECTION)
        change = abs(target - self.in_use)
        disagreement = self.disagreement
        if disagreement is None or change <= max(
            MIN_FOCAL_CHANGE,
            MIN_FOCAL_CHANGE_SIGMAS * self.sigma,
            MIN_FOCAL_DISAGREEMENT_SHARE * abs(disagreement[0]),
        ):
            return False
        self._prior = (target, hypot(self.sigma, FOCAL_NONLINEARITY * change))
        self.in_use = target
        # Former views are not linear in the change.
        self._former, self._current = np.zeros((2, 2)), np.zeros((2, 2))
        return True
