"""How sure an alignment is: its covariance, and which directions of motion it settles.

Neighbouring readings share errors: of the keyframe's depth, of interpolation, of calibration. How
far cells of the image pull in different directions tells how much (the "sandwich" estimator for
clustered observations: Liang and Zeger, Biometrika 73, 1986).
"""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, carried, inverse
from vo_service.odometry.directions import Directions, directions, point_information
from vo_service.odometry.keyframe.alignment import Alignment, Tie, information
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.noise import weigh
from vo_service.odometry.keyframe.parameters import KNOWN

# Nothing is surer than this: what calibration and timing leave over, in metres and radians.
FLOOR_M, FLOOR_RAD = 1e-4, 1e-4


@dataclass(frozen=True)
class Certainty:
    """How sure a motion is.

    covariance  6x6 of T_keyframe_camera: (translation m, rotation rad), as a small motion in the
                camera's axes
    directions  which directions of a small motion of the keyframe's points the readings settle
    """

    covariance: Array
    directions: Directions

    @property
    def doubt(self) -> str:
        """Why the motion is not to be believed, though the keyframe fits; "" if it is."""
        unknown = np.count_nonzero(self.directions.clarity < KNOWN)
        return f"too plain a view: {unknown} of 6 directions of motion are open" if unknown else ""


def certainty(keyframe: Keyframe, images: Images, found: Alignment, tie: Tie) -> Certainty:
    """Of an alignment and what its velocity was tied to."""
    H, _ = information(keyframe.points, images, found)
    whole, finest = images.intrinsics[0], images.intrinsics[1]
    pulls, moments = weigh(
        keyframe.points[0],
        found.readings,
        found.weights,
        found.fit,
        images.shutter.readout_s,
        images.shutter.skew_s,
        finest[0],
        whole[0],
    )
    settled = directions(H[:6, :6], point_information(moments))
    of_tie = _information(tie)
    bread = np.linalg.inv(H + of_tie + 1e-9 * np.trace(H) * np.eye(12))
    spread = pulls.T @ pulls + of_tie
    whole_cov = bread @ spread @ bread
    in_keyframe = whole_cov[:6, :6]
    A = np.linalg.solve(H[:6, :6] + 1e-9 * np.trace(H) * np.eye(6), H[:6, 6:])
    in_keyframe = in_keyframe + A @ whole_cov[6:, 6:] @ A.T
    in_camera = carried(in_keyframe, inverse(found.T_camera_keyframe))
    floor = np.diag(np.repeat([FLOOR_M**2, FLOOR_RAD**2], 3))
    return Certainty(0.5 * (in_camera + in_camera.T) + floor, settled)


def _information(tie: Tie) -> Array:
    """(12, 12) of the tie between motion and velocity."""
    both, rate_hz = np.zeros((12, 12)), tie.rate_hz
    motion, velocity = np.arange(6), np.arange(6, 12)
    both[motion, motion] = rate_hz**2 * tie.information
    both[motion, velocity] = both[velocity, motion] = -rate_hz * tie.information
    both[velocity, velocity] = tie.information
    return both
