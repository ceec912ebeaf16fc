"""Whether to believe an alignment, and how far."""

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.icp.alignment import MIN_PLANES, IcpAlignment

# Of a reference's planes, this share at least is seen.
MIN_IN_GATE_SHARE = 0.3
# Of those that come to lie on readings, this share agrees with them. Measured: 0.62 and more where
# the motion found is right, 0.52 and less where it is wrong.
MIN_INLIER_SHARE = 0.6
# Largest spread of the residuals, 1/m. Measured: 3.6e-3 and less where right.
MAX_SIGMA_PER_M = 5e-3
# Neighbouring readings share the sensor's steps, and the reference's noise is in all of them:
# the covariance is so many times what it would be with as many independent ones.
COVARIANCE_INFLATION = 15.0


def rejection_reason(alignment: IcpAlignment) -> str:
    """Why an alignment is not to be believed; "" if it is."""
    if alignment.num_in_gate < max(MIN_PLANES, MIN_IN_GATE_SHARE * alignment.num_planes):
        return f"{alignment.num_in_gate} of {alignment.num_planes} surface points are in view"
    if not alignment.has_converged:
        return f"{alignment.num_in_gate} surface points do not settle"
    if (
        alignment.num_inliers < MIN_INLIER_SHARE * alignment.num_with_reading
        or alignment.sigma > MAX_SIGMA_PER_M
    ):
        return f"{alignment.num_inliers} of {alignment.num_with_reading} surface points agree"
    count = np.count_nonzero(~alignment.degeneracy.is_observable)
    return f"too flat a view: depth leaves {count} of 6 directions of motion open" if count else ""


def alignment_covariance(alignment: IcpAlignment) -> Array:
    """6x6 of T_reference_camera: (translation m, rotation rad), a motion in the camera's axes.

    All six directions are known.
    """
    variance = COVARIANCE_INFLATION * alignment.sigma**2
    in_reference = np.asarray(variance * np.linalg.inv(alignment.information), np.float64)
    in_camera = transport_covariance(in_reference, inverse(alignment.T_camera_reference))
    return 0.5 * (in_camera + in_camera.T)
