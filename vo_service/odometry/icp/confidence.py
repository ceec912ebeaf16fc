"""Whether to believe an alignment, and how far."""

import numpy as np

from drivers.geometry import Array, carried, inverse
from vo_service.odometry.icp.alignment import FEWEST_PLANES, Alignment

# Of a reference's planes, this share at least is seen.
LEAST_SEEN = 0.3
# Of those that come to lie on readings, this share agrees with them. Measured: 0.62 and more where
# the motion found is right, 0.52 and less where it is wrong.
LEAST_AGREEING = 0.6
# Largest spread of the residuals, 1/m. Measured: 3.6e-3 and less where right.
LARGEST_SIGMA = 5e-3
# Neighbouring readings share the sensor's steps, and the reference's noise is in all of them:
# the covariance is so many times what it would be with as many independent ones.
DEPENDENCE = 15.0
# How far off a guessed motion may be: a hand-held camera or a slow robot that stops or starts.
GUESS_M_S, GUESS_RAD_S = 0.5, 1.0


def misfit(alignment: Alignment) -> str:
    """Why the planes are not where the surfaces are; "" if they are."""
    if alignment.seen < max(FEWEST_PLANES, LEAST_SEEN * alignment.planes):
        return f"{alignment.seen} of {alignment.planes} surface points are in view"
    if not alignment.has_settled:
        return f"{alignment.seen} surface points do not settle"
    if alignment.agreeing < LEAST_AGREEING * alignment.read or alignment.sigma > LARGEST_SIGMA:
        return f"{alignment.agreeing} of {alignment.read} surface points agree"
    return ""


def doubt(alignment: Alignment) -> str:
    """Why an alignment is not to be believed, be it that it fits; "" if it is."""
    count = np.count_nonzero(~alignment.directions.is_known)
    flat = f"too flat a view: depth leaves {count} of 6 directions of motion open" if count else ""
    return misfit(alignment) or flat


def covariance(alignment: Alignment, duration_s: float) -> Array:
    """6x6 of T_reference_camera: (translation m, rotation rad), a motion in the camera's axes.

    duration_s  for which the directions that are not known have been guessed
    """
    is_known, axes = alignment.directions.is_known, alignment.directions.axes
    # The axes are such that axes^T information axes is the diagonal matrix of the clarity.
    scaled = axes[:, is_known] / np.sqrt(alignment.directions.clarity[is_known])
    guess = axes[:, ~is_known] @ np.linalg.inv(axes)[~is_known]
    spread = guess @ np.diag([GUESS_M_S] * 3 + [GUESS_RAD_S] * 3) * duration_s
    variance = DEPENDENCE * alignment.sigma**2
    in_reference = np.asarray(variance * scaled @ scaled.T + spread @ spread.T, np.float64)
    in_camera = carried(in_reference, inverse(alignment.T_camera_reference))
    return 0.5 * (in_camera + in_camera.T)
