"""How a moving camera's view sweeps past, which a shutter that rolls sees bent.

Each row has an instant of its own. At a steady velocity all rays can be brought to the instant of
the middle row (Hedborg, Forssén, Felsberg and Ringaby, "Rolling Shutter Bundle Adjustment", CVPR
2012, interpolate the poses of the rows alike).
"""

from dataclasses import dataclass, field

import numpy as np

from drivers.geometry import Array, rotation_vector


@dataclass(frozen=True)
class Sweep:
    """The camera's velocity, in its own axes.

    shift_per_s  (3,) that of its place, over the distance of what is seen
    turn_rad_s   (3,) that of its direction
    """

    shift_per_s: Array = field(default_factory=lambda: np.zeros(3))
    turn_rad_s: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def over(cls, T_before_after: Array, duration_s: float, inverse_depth: float) -> "Sweep":
        """The mean over a motion, in the axes at its end; none of a motion that took no time.

        inverse_depth  1/m, of what is seen
        """
        if duration_s == 0.0:
            return cls()
        R, t_m = T_before_after[:3, :3], T_before_after[:3, 3]
        return cls(R.T @ t_m * (inverse_depth / duration_s), rotation_vector(R) / duration_s)

    def undone(self, ray: Array, delay_s: Array) -> Array:
        """(N, 3) rays, z = 1, as they are at delay 0; `ray` (N, 3), z = 1, is after `delay_s` (N,).

        Turns to second order, which leaves hundredths of a pixel at 4 rad/s.
        """
        turn_rad = delay_s[:, None] * self.turn_rad_s
        turned = np.cross(turn_rad, ray)
        moved = (
            ray + turned + 0.5 * np.cross(turn_rad, turned) + delay_s[:, None] * self.shift_per_s
        )
        still: Array = moved / moved[:, 2:]
        return still
