"""Validity and covariance of an alignment."""

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.icp.alignment import MIN_PLANES, IcpAlignment

# Smallest share of the reference's planes in the gate.
MIN_IN_GATE_SHARE = 0.3
# Smallest share of inliers among the planes with a reading. Measured: at least 0.62 where the
# motion is right, at most 0.52 where it is wrong.
MIN_INLIER_SHARE = 0.6
# Largest sigma of the residuals, 1/m. Measured: at most 3.6e-3 where the motion is right.
MAX_SIGMA_PER_M = 5e-3
# Factor for correlated errors: neighboring readings share the sensor's quantization, and all share
# the noise of the reference.
COVARIANCE_INFLATION = 15.0


def rejection_reason(alignment: IcpAlignment) -> str:
    """Why an alignment is rejected; "" if it is valid."""
    if alignment.num_in_gate < max(MIN_PLANES, MIN_IN_GATE_SHARE * alignment.num_planes):
        return f"only {alignment.num_in_gate} of {alignment.num_planes} surface points are in view"
    if not alignment.has_converged:
        return f"the alignment of {alignment.num_in_gate} surface points does not converge"
    if (
        alignment.num_inliers < MIN_INLIER_SHARE * alignment.num_with_reading
        or alignment.sigma > MAX_SIGMA_PER_M
    ):
        return f"only {alignment.num_inliers} of {alignment.num_with_reading} surface points agree"
    count = np.count_nonzero(~alignment.degeneracy.is_observable)
    if count == 0:
        return ""
    return f"degenerate view: depth leaves {count} of 6 degrees of freedom unconstrained"


def alignment_covariance(alignment: IcpAlignment) -> Array:
    """6x6 of T_reference_camera: (translation m, rotation rad), a motion in the camera's axes.

    All six degrees of freedom have to be constrained.
    """
    variance = COVARIANCE_INFLATION * alignment.sigma**2
    in_reference = np.asarray(variance * np.linalg.inv(alignment.information), np.float64)
    in_camera = transport_covariance(in_reference, inverse(alignment.T_camera_reference))
    return 0.5 * (in_camera + in_camera.T)
