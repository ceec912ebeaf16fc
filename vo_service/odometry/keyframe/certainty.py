"""How sure an alignment is: its covariance, and which directions of motion it settles.

Neighbouring readings share errors: of the keyframe's depth, of interpolation, of calibration. How
far cells of the image pull in different directions tells how much (the "sandwich" estimator for
clustered observations: Liang and Zeger, Biometrika 73, 1986).
"""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, inverse, transport_covariance
from vo_service.odometry.directions import DegeneracyAnalysis, analyze_degeneracy, point_information
from vo_service.odometry.keyframe.alignment import DirectAlignment, MotionPrior, PointPyramid
from vo_service.odometry.keyframe.images import ImagePyramid, ImageTiming
from vo_service.odometry.keyframe.movement import ACCELERATION_START, NUM_UNKNOWNS
from vo_service.odometry.keyframe.noise import accumulate_scores
from vo_service.odometry.keyframe.parameters import COVARIANCE_INFLATION, GATE_SIGMAS
from vo_service.odometry.keyframe.system import (
    UPPER_TRIANGLE,
    accumulate,
    band_times,
    expand_rolling_shutter,
)

# Nothing is surer than this: what calibration and timing leave over, in m and rad.
MIN_SIGMAS = (1e-4, 1e-4)


@dataclass(frozen=True)
class MotionUncertainty:
    """How sure a motion is.

    covariance  6x6 of T_keyframe_camera: (translation m, rotation rad), as a small motion in the
                camera's axes
    directions  which directions of a small motion of the keyframe's points the readings settle
    """

    covariance: Array
    degeneracy: DegeneracyAnalysis

    @property
    def observability(self) -> float:
        """Of the direction that the readings say the least of: see `DegeneracyAnalysis`."""
        return float(self.degeneracy.observability[0])

    @property
    def rejection_reason(self) -> str:
        """Why the motion is not to be believed, though the keyframe fits; "" if it is."""
        unknown = np.count_nonzero(self.degeneracy.observability < GATE_SIGMAS)
        return f"too plain a view: {unknown} of 6 directions of motion are open" if unknown else ""


def estimate_uncertainty(
    points: PointPyramid,
    images: ImagePyramid,
    alignment: DirectAlignment,
    prior: MotionPrior,
    velocity_noise: Array,
) -> MotionUncertainty:
    """Of an alignment and what its velocity was tied to.

    points     of the keyframe, an array for each level
    agitation  (2,) how much the velocity changes from frame to frame, m/s and rad/s
    """
    shutter, finest = images.shutter, points[0]
    bands = accumulate(finest, alignment.samples, alignment.cell_weights, alignment.residual_model)
    H, _ = expand_rolling_shutter(bands, shutter.readout_s, shutter.skew_s)
    pulls, moments = accumulate_scores(
        finest,
        alignment.samples,
        alignment.cell_weights,
        alignment.residual_model,
        shutter.readout_s,
        shutter.skew_s,
        images.intrinsics[1][0],
        images.intrinsics[0][0],
    )
    pulls = np.vstack([pulls, _band_scores(bands, shutter)])
    in_keyframe = COVARIANCE_INFLATION * _sandwich_covariance(H, pulls, prior)
    in_keyframe += _velocity_noise_covariance(H, bands, shutter, velocity_noise)
    in_camera = transport_covariance(in_keyframe, inverse(alignment.T_camera_keyframe))
    floor = np.diag(np.repeat(np.square(MIN_SIGMAS), 3))
    return MotionUncertainty(
        covariance=0.5 * (in_camera + in_camera.T) + floor,
        degeneracy=analyze_degeneracy(H[:6, :6], point_information(moments)),
    )


def _sandwich_covariance(H: Array, scores: Array, prior: MotionPrior) -> Array:
    """6x6 for what the readings disagree about, and for the movements of frame and keyframe."""
    of_tie = _prior_information(prior)
    bread = np.linalg.inv(_regularize(H + of_tie))
    both = bread @ (scores.T @ scores + of_tie) @ bread
    # The keyframe's rows were brought to one instant by a movement that is no better known.
    moves = np.linalg.solve(_regularize(H[:6, :6]), H[:6, 6:])
    covariance: Array = both[:6, :6] + moves @ both[6:, 6:] @ moves.T
    return covariance


def _band_scores(bands: Array, shutter: ImageTiming) -> Array:
    """(2 BANDS, 15) what each band of rows pulls the motion and the movement by."""
    pulls, times_s = bands[:, 21:], band_times(shutter.readout_s, shutter.skew_s)[:, None]
    return np.hstack([pulls, times_s * pulls, 0.5 * times_s**2 * pulls[:, 3:]])


def _velocity_noise_covariance(
    H: Array, bands: Array, shutter: ImageTiming, velocity_noise: Array
) -> Array:
    """6x6 for how the camera strays from a constant velocity while it takes the rows of an image.

    Each band of rows, of the frame and of the keyframe, is off by a motion of its own.
    """
    if shutter.is_instant:
        return np.zeros((6, 6))
    span_s = shutter.readout_s + abs(shutter.skew_s)
    # Rows are spread evenly over that time, and each is off by as long as it is from its middle.
    stray = np.repeat((span_s * velocity_noise) ** 2 / 12.0, 3)
    of_band = bands[:, UPPER_TRIANGLE]
    spread = 2.0 * np.einsum("kij,j,klj->il", of_band, stray, of_band)
    bread = np.linalg.inv(_regularize(H[:6, :6]))
    return np.asarray(bread @ spread @ bread, np.float64)


def _prior_information(prior: MotionPrior) -> Array:
    """(15, 15) of the tie between motion and movement."""
    both, rate_hz = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), prior.rate_hz
    motion, velocity, movement = np.arange(6), np.arange(6, 12), np.arange(6, NUM_UNKNOWNS)
    of_velocity = prior.information[:ACCELERATION_START]
    both[motion, motion] = rate_hz**2 * of_velocity
    both[motion, velocity] = both[velocity, motion] = -rate_hz * of_velocity
    both[movement, movement] = prior.information
    return both


def _regularize(H: Array) -> Array:
    return np.asarray(H + 1e-9 * np.trace(H) * np.eye(len(H)), np.float64)
