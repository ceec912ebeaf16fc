"""How a moving camera's view sweeps past, which a shutter that rolls sees bent.

Each row has an instant of its own. At a steady velocity all rays can be brought to the instant of
the middle row (Hedborg, Forssén, Felsberg and Ringaby, "Rolling Shutter Bundle Adjustment", CVPR
2012, interpolate the poses of the rows alike).
"""

from dataclasses import dataclass, field

import numpy as np

from drivers.core.geometry import Array, so3_log


@dataclass(frozen=True)
class ShutterMotion:
    """The camera's velocity, in its own axes.

    shift_per_s  (3,) that of its place, over the distance of what is seen
    turn_rad_s   (3,) that of its direction
    """

    translation_per_s: Array = field(default_factory=lambda: np.zeros(3))
    angular_velocity_rad_s: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_motion(
        cls, T_before_after: Array, duration_s: float, inverse_depth: float
    ) -> "ShutterMotion":
        """The mean over a motion, in the axes at its end; none of a motion that took no time.

        inverse_depth  1/m, of what is seen
        """
        if duration_s == 0.0:
            return cls()
        R, t_m = T_before_after[:3, :3], T_before_after[:3, 3]
        return cls(R.T @ t_m * (inverse_depth / duration_s), so3_log(R) / duration_s)

    def undistort_rays(self, ray: Array, delay_s: Array) -> Array:
        """(N, 3) rays, z = 1, as they are at delay 0; `ray` (N, 3), z = 1, is after `delay_s` (N,).

        Turns to second order, which leaves hundredths of a pixel at 4 rad/s.
        """
        turn_rad = delay_s[:, None] * self.angular_velocity_rad_s
        turned = np.cross(turn_rad, ray)
        moved = (
            ray
            + turned
            + 0.5 * np.cross(turn_rad, turned)
            + delay_s[:, None] * self.translation_per_s
        )
        still: Array = moved / moved[:, 2:]
        return still
