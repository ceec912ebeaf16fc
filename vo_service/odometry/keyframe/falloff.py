"""How much light the lens loses towards the corners: learnt from places that move through the view.

Where the tangent of the angle to its axis is r, it shows 1 - falloff r^2 of what it shows in the
middle. Left out, whatever comes in from the side gets brighter, and a turn seems to be a little
less or more than it was. Goldman, "Vignette and Exposure Calibration and Compensation" (PAMI 32,
2010), who finds it with the exposure, as here.
"""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array
from drivers.jit import kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.alignment import Alignment
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.parameters import FADING, FREEDOM, HALF, SLIGHT
from vo_service.odometry.keyframe.points import BRIGHTNESS, HAS_TEXTURE, VARIANCE
from vo_service.odometry.keyframe.readings import further_out
from vo_service.odometry.keyframe.system import GAIN, OFFSET, SIGMA_BRIGHTNESS

# A single view is off by this (sigma), how many readings it may have: surfaces shine, and lamps are
# near.
OF_A_VIEW = HALF * SLIGHT


@dataclass(frozen=True)
class Falloff:
    """What is known of it.

    value        0 for none
    information  1 / variance of it
    """

    value: float = 0.0
    information: float = SLIGHT**-2

    def with_view(self, keyframe: Keyframe, images: Images, found: Alignment) -> "Falloff":
        """The same, by a view in which the keyframe's points have moved far."""
        H, g = _regress(
            keyframe.points[0], found.readings, found.weights, found.fit, images.intrinsics[0]
        )
        if H[2, 2] <= 0.0:
            return self
        inverse = np.linalg.inv(H + 1e-9 * np.diag(np.diag(H)) + 1e-9 * np.eye(3))
        told = images.falloff + float(inverse[2] @ g)
        known = FADING * self.information
        more = 1.0 / (OF_A_VIEW**2 + float(inverse[2, 2]))
        value = (known * self.value + more * told) / (known + more)
        return Falloff(min(max(value, -HALF), HALF), known + more)


@kernel
def _regress(
    points: Array, readings: Array, weights: Array, fit: Array, intrinsics: Array
) -> tuple[Array, Array]:
    """Normal equations (3, 3) and (3,) of changes of gain, offset and falloff."""
    H, g, J = np.zeros((3, 3)), np.zeros(3), np.ones(3)
    for i in range(len(points)):
        brightness = readings[i, reading_columns.BRIGHTNESS]
        if np.isnan(brightness) or points[i, HAS_TEXTURE] == 0:
            continue
        u, v = readings[i, reading_columns.U], readings[i, reading_columns.V]
        mine = fit[GAIN] * points[i, BRIGHTNESS]
        residual = brightness - mine - fit[OFFSET]
        of_this = fit[SIGMA_BRIGHTNESS] ** 2 + points[i, VARIANCE]
        w = (FREEDOM + 1.0) / (FREEDOM + residual * residual / of_this) / of_this
        w *= weights[0, int(readings[i, reading_columns.CELL])]
        J[0], J[2] = mine, -mine * further_out(u, v, intrinsics, points[i])
        for a in range(3):
            for b in range(3):
                H[a, b] += w * J[a] * J[b]
            g[a] += w * J[a] * residual
    return H, g
