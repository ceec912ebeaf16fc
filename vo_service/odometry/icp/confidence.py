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


def doubt(alignment: Alignment) -> str:
    """Why an alignment is not to be believed; "" if it is."""
    if alignment.seen < max(FEWEST_PLANES, LEAST_SEEN * alignment.planes):
        return f"{alignment.seen} of {alignment.planes} surface points are in view"
    if not alignment.has_settled:
        return f"{alignment.seen} surface points do not settle"
    if alignment.agreeing < LEAST_AGREEING * alignment.read or alignment.sigma > LARGEST_SIGMA:
        return f"{alignment.agreeing} of {alignment.read} surface points agree"
    count = np.count_nonzero(~alignment.directions.is_known)
    return f"too flat a view: depth leaves {count} of 6 directions of motion open" if count else ""


def covariance(alignment: Alignment) -> Array:
    """6x6 of T_reference_camera: (translation m, rotation rad), a motion in the camera's axes.

    All six directions are known.
    """
    variance = DEPENDENCE * alignment.sigma**2
    in_reference = np.asarray(variance * np.linalg.inv(alignment.information), np.float64)
    in_camera = carried(in_reference, inverse(alignment.T_camera_reference))
    return 0.5 * (in_camera + in_camera.T)
