"""How sure an alignment is: its covariance, and which directions of motion it settles.

Neighbouring readings share errors: of the keyframe's depth, of interpolation, of calibration. How
far cells of the image pull in different directions tells how much (the "sandwich" estimator for
clustered observations: Liang and Zeger, Biometrika 73, 1986).
"""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, carried, inverse
from vo_service.odometry.directions import Directions, directions, point_information
from vo_service.odometry.keyframe.alignment import Alignment, Points, Tie
from vo_service.odometry.keyframe.images import Images, Shutter
from vo_service.odometry.keyframe.movement import ACCELERATION, UNKNOWNS
from vo_service.odometry.keyframe.noise import weigh
from vo_service.odometry.keyframe.parameters import SHARED, SIGMAS
from vo_service.odometry.keyframe.system import UPPER, band_times, sum_bands, with_times

# Nothing is surer than this: what calibration and timing leave over, in m and rad.
SUREST = (1e-4, 1e-4)


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
    def clarity(self) -> float:
        """Of the direction that the readings say the least of: see `Directions`."""
        return float(self.directions.clarity[0])

    @property
    def doubt(self) -> str:
        """Why the motion is not to be believed, though the keyframe fits; "" if it is."""
        unknown = np.count_nonzero(self.directions.clarity < SIGMAS)
        return f"too plain a view: {unknown} of 6 directions of motion are open" if unknown else ""


def certainty(
    points: Points, images: Images, found: Alignment, tie: Tie, agitation: Array
) -> Certainty:
    """Of an alignment and what its velocity was tied to.

    points     of the keyframe, an array for each level
    agitation  (2,) how much the velocity changes from frame to frame, m/s and rad/s
    """
    shutter, finest = images.shutter, points[0]
    bands = sum_bands(finest, found.readings, found.weights, found.fit)
    H, _ = with_times(bands, shutter.readout_s, shutter.skew_s)
    pulls, moments = weigh(
        finest,
        found.readings,
        found.weights,
        found.fit,
        shutter.readout_s,
        shutter.skew_s,
        images.intrinsics[1][0],
        images.intrinsics[0][0],
    )
    pulls = np.vstack([pulls, _pulls_of_bands(bands, shutter)])
    in_keyframe = SHARED * _of_readings(H, pulls, tie)
    in_keyframe += _of_strays(H, bands, shutter, agitation)
    in_camera = carried(in_keyframe, inverse(found.T_camera_keyframe))
    floor = np.diag(np.repeat(np.square(SUREST), 3))
    return Certainty(
        covariance=0.5 * (in_camera + in_camera.T) + floor,
        directions=directions(H[:6, :6], point_information(moments)),
    )


def _of_readings(H: Array, pulls: Array, tie: Tie) -> Array:
    """6x6 for what the readings disagree about, and for the movements of frame and keyframe."""
    of_tie = _information(tie)
    bread = np.linalg.inv(_regular(H + of_tie))
    both = bread @ (pulls.T @ pulls + of_tie) @ bread
    # The keyframe's rows were brought to one instant by a movement that is no better known.
    moves = np.linalg.solve(_regular(H[:6, :6]), H[:6, 6:])
    covariance: Array = both[:6, :6] + moves @ both[6:, 6:] @ moves.T
    return covariance


def _pulls_of_bands(bands: Array, shutter: Shutter) -> Array:
    """(2 BANDS, 15) what each band of rows pulls the motion and the movement by."""
    pulls, times_s = bands[:, 21:], band_times(shutter.readout_s, shutter.skew_s)[:, None]
    return np.hstack([pulls, times_s * pulls, 0.5 * times_s**2 * pulls[:, 3:]])


def _of_strays(H: Array, bands: Array, shutter: Shutter, agitation: Array) -> Array:
    """6x6 for how the camera strays from a constant velocity while it takes the rows of an image.

    Each band of rows, of the frame and of the keyframe, is off by a motion of its own.
    """
    if shutter.is_instant:
        return np.zeros((6, 6))
    span_s = shutter.readout_s + abs(shutter.skew_s)
    # Rows are spread evenly over that time, and each is off by as long as it is from its middle.
    stray = np.repeat((span_s * agitation) ** 2 / 12.0, 3)
    of_band = bands[:, UPPER]
    spread = 2.0 * np.einsum("kij,j,klj->il", of_band, stray, of_band)
    bread = np.linalg.inv(_regular(H[:6, :6]))
    return np.asarray(bread @ spread @ bread, np.float64)


def _information(tie: Tie) -> Array:
    """(15, 15) of the tie between motion and movement."""
    both, rate_hz = np.zeros((UNKNOWNS, UNKNOWNS)), tie.rate_hz
    motion, velocity, movement = np.arange(6), np.arange(6, 12), np.arange(6, UNKNOWNS)
    of_velocity = tie.information[:ACCELERATION]
    both[motion, motion] = rate_hz**2 * of_velocity
    both[motion, velocity] = both[velocity, motion] = -rate_hz * of_velocity
    both[movement, movement] = tie.information
    return both


def _regular(H: Array) -> Array:
    return np.asarray(H + 1e-9 * np.trace(H) * np.eye(len(H)), np.float64)
