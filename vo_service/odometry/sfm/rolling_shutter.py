"""Compensation of a rolling shutter at constant velocity.

Each row has its own time. At a constant velocity all rays can be transformed to the time of the
middle row. Hedborg, Forssén, Felsberg and Ringaby, "Rolling Shutter Bundle Adjustment" (CVPR 2012)
interpolate the poses of the rows in the same way.
"""

from dataclasses import dataclass, field

import numpy as np

from drivers.core.geometry import Array, so3_log


@dataclass(frozen=True)
class ShutterMotion:
    """Velocity of the camera in its own axes.

    Attributes:
        translation_per_s: (3,) linear velocity divided by the depth of the scene.
        angular_velocity_rad_s: (3,).
    """

    translation_per_s: Array = field(default_factory=lambda: np.zeros(3))
    angular_velocity_rad_s: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_motion(
        cls, T_before_after: Array, duration_s: float, inverse_depth: float
    ) -> "ShutterMotion":
        """Mean velocity over a motion, in the axes at its end; 0 for a duration of 0.

        Args:
            T_before_after: 4x4 motion.
            duration_s: Time of the motion.
            inverse_depth: Of the scene, 1/m.
        """
        if duration_s == 0.0:
            return cls()
        R, t_m = T_before_after[:3, :3], T_before_after[:3, 3]
        return cls(R.T @ t_m * (inverse_depth / duration_s), so3_log(R) / duration_s)

    def undistort_rays(self, ray: Array, delay_s: Array) -> Array:
        """Transform rays (N, 3), z = 1, observed after a delay (N,), to delay 0.

        The rotation is of second order: the error is hundredths of a pixel at 4 rad/s.
        """
        rotation_rad = delay_s[:, None] * self.angular_velocity_rad_s
        rotated = np.cross(rotation_rad, ray)
        moved = (
            ray
            + rotated
            + 0.5 * np.cross(rotation_rad, rotated)
            + delay_s[:, None] * self.translation_per_s
        )
        undistorted: Array = moved / moved[:, 2:]
        return undistorted
