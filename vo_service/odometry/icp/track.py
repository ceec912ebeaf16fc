"""Track of the ICP odometry: the reference, the last good frame, and validity of alignments."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.icp.alignment import MIN_PLANES, IcpAlignment, PlanePyramid
from vo_service.odometry.icp.depth_pyramid import DepthPyramid
from vo_service.odometry.icp.planes import find_planes
from vo_service.odometry.uncertainty import MIN_OBSERVABILITY

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


# A reference is replaced when less than this share of its planes is in view,
RENEW_SHARE = 0.75
# but while the view constrains some direction poorly, only below this share.
MIN_SHARE = 0.5
GOOD_OBSERVABILITY = 2.0 * MIN_OBSERVABILITY


@dataclass(frozen=True)
class IcpTrack:
    """A reference that frames are aligned with, and the last good frame.

    Attributes:
        planes: (N, 7) of the reference for each level.
        last_frame: The last good frame.
        T_camera_reference: 4x4 of that frame.
        covariance: 6x6 of that motion, (translation m, rotation rad), as a small motion in the last
            camera's axes; zero if the last frame is the reference.
    """

    planes: PlanePyramid
    last_frame: DepthPyramid
    T_camera_reference: Array
    covariance: Array

    def advance(self, view: DepthPyramid, alignment: IcpAlignment) -> "IcpTrack":
        """Return the track at the next good frame."""
        return IcpTrack(
            self.planes, view, alignment.T_camera_reference, alignment_covariance(alignment)
        )

    def relative_motion(self, after: "IcpTrack") -> tuple[Array, Array]:
        """4x4 T_last_camera between two tracks of one reference, and its 6x6 covariance.

        The errors of both frames are added, each in its own camera's axes.
        """
        T_last_camera = self.T_camera_reference @ inverse(after.T_camera_reference)
        return T_last_camera, transport_covariance(
            self.covariance, T_last_camera
        ) + after.covariance


def start_track(view: DepthPyramid, max_planes: int) -> IcpTrack:
    """Start a track with this frame as the reference, with at most `max_planes` per level."""
    planes = tuple(find_planes(level, max_planes) for level in view.levels)
    return IcpTrack(planes, view, np.eye(4), np.zeros((6, 6)))


def needs_new_reference(alignment: IcpAlignment) -> bool:
    """Whether the reference is to be replaced by the current frame.

    A poorly constrained view makes a poor reference, so the old one is kept longer.
    """
    share = alignment.num_in_gate / alignment.num_planes
    if share >= RENEW_SHARE:
        return False
    return share < MIN_SHARE or bool(alignment.degeneracy.observability[0] >= GOOD_OBSERVABILITY)
