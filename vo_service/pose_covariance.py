"""How sure the pose is: the covariance of each motion, added up since the epoch began."""

import numpy as np

from drivers.geometry import Array, carried
from vo_service.odometry.estimate import Estimate

# A pose is never surer than this: sigma of the first pose of an epoch.
FLOOR_SIGMA_M, FLOOR_SIGMA_RAD = 1e-4, 1e-4


class PoseCovariance:
    """Follows a chain of good estimates. All is 6x6, (translation m, rotation rad).

    pose  of the last pose since the beginning, as a small motion in the camera's axes
    step  of the motion since the good frame before that, likewise
    """

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """The next pose is where everything is counted from."""
        self.pose = diagonal(FLOOR_SIGMA_M, FLOOR_SIGMA_RAD)
        self.step = np.zeros((6, 6))
        self._of_reference = self.pose  # in the reference's axes
        self._since_reference = np.zeros((6, 6))  # of the last good frame

    def add(self, estimate: Estimate, T_last_camera: Array) -> None:
        """The next good estimate, and the 4x4 motion since the good one before."""
        T_reference_camera, since = estimate.T_reference_camera, estimate.covariance
        self.pose = carried(self._of_reference, T_reference_camera) + since
        # Both frames were laid on the reference: the errors of both are in the step.
        self.step = carried(self._since_reference, T_last_camera) + since
        self._since_reference = since
        if estimate.is_next_reference:
            self._of_reference = self.pose
            self._since_reference = np.zeros((6, 6))


def diagonal(sigma_m: float, sigma_rad: float) -> Array:
    """6x6 covariance, alike in all directions."""
    return np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
