"""How sure the pose is: the covariance of each motion, added up since the epoch began."""

import numpy as np

from drivers.core.geometry import Array, transport_covariance
from vo_service.types import Estimate

# A pose is never surer than this: sigma of the first pose of an epoch.
MIN_SIGMA_M, MIN_SIGMA_RAD = 1e-4, 1e-4


class CovarianceAccumulator:
    """Follows a chain of good estimates. All is 6x6, (translation m, rotation rad).

    pose  of the last pose since the beginning, as a small motion in the camera's axes
    step  of the motion since the good frame before that, likewise
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """The next pose is where everything is counted from."""
        self.pose = diagonal_covariance(MIN_SIGMA_M, MIN_SIGMA_RAD)
        self.step = np.zeros((6, 6))
        self._reference_covariance = self.pose  # in the reference's axes
        self._last_covariance: Array | None = (
            None  # since the reference, of a last good frame that is none
        )

    def add(self, estimate: Estimate, T_last_camera: Array) -> None:
        """The next good estimate, and the 4x4 motion since the good one before."""
        T_reference_camera, since = estimate.T_reference_camera, estimate.covariance
        self.pose = transport_covariance(self._reference_covariance, T_reference_camera) + since
        self.step = (
            since
            if self._last_covariance is None
            else _step_covariance(self._last_covariance, since, T_last_camera)
        )
        self._last_covariance = since
        if estimate.is_next_reference:
            self._reference_covariance = self.pose
            self._last_covariance = None


def _step_covariance(last: Array, this: Array, T_last_this: Array) -> Array:
    """Of the motion between two frames that were laid on one reference, as sure as is said.

    A reading that is compared with the reference's is as wrong as both, and one is no better than
    the other: half of either error is the reference's, which is the same in both frames.
    """
    return 0.5 * (transport_covariance(last, T_last_this) + this)


def diagonal_covariance(sigma_m: float, sigma_rad: float) -> Array:
    """6x6 covariance, alike in all directions."""
    return np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
