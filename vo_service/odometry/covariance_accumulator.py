"""Accumulated covariance of the pose since the start of an epoch."""

import numpy as np

from drivers.core.geometry import Array, transport_covariance
from vo_service.types import Estimate

# Sigma of the first pose of an epoch.
MIN_SIGMA_M, MIN_SIGMA_RAD = 1e-4, 1e-4


class CovarianceAccumulator:
    """Accumulate the covariance along a chain of good estimates.

    Attributes:
        pose: 6x6 of the last pose since the start: (translation m, rotation rad), as a small
            motion in the camera's axes.
        step: 6x6 of the motion since the last good frame, likewise.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Make the next pose the origin."""
        self.pose = diagonal_covariance(MIN_SIGMA_M, MIN_SIGMA_RAD)
        self.step = np.zeros((6, 6))
        self._reference_covariance = self.pose  # in the reference's axes
        # Of the last good frame against the reference; None if it is the reference.
        self._last_covariance: Array | None = None

    def add(self, estimate: Estimate, T_last_camera: Array) -> None:
        """Add a good estimate, and the 4x4 motion since the last good one."""
        covariance = estimate.covariance
        self.pose = covariance + transport_covariance(
            self._reference_covariance, estimate.T_reference_camera
        )
        self.step = (
            covariance
            if self._last_covariance is None
            else _step_covariance(self._last_covariance, covariance, T_last_camera)
        )
        self._last_covariance = covariance
        if estimate.is_next_reference:
            self._reference_covariance = self.pose
            self._last_covariance = None


def _step_covariance(last: Array, this: Array, T_last_this: Array) -> Array:
    """6x6 of the motion between two frames that are aligned with one reference.

    Half of each error is that of the reference, which is the same in both frames and cancels.
    """
    return 0.5 * (transport_covariance(last, T_last_this) + this)


def diagonal_covariance(sigma_m: float, sigma_rad: float) -> Array:
    """6x6 covariance, equal in all directions."""
    return np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
