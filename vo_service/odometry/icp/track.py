"""What is carried from frame to frame: a reference, and where the last good camera is from it."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.degeneracy import MIN_OBSERVABILITY
from vo_service.odometry.icp.alignment import IcpAlignment, PlanePyramid
from vo_service.odometry.icp.depth_pyramid import DepthPyramid
from vo_service.odometry.icp.planes import find_planes
from vo_service.odometry.icp.quality import alignment_covariance

# A reference is replaced when less than this share of its planes is seen, ...
RENEW_SHARE = 0.75
# ... but while the view says little of some direction, only when it is less than this.
MIN_SHARE = 0.5
GOOD_OBSERVABILITY = 2.0 * MIN_OBSERVABILITY


@dataclass(frozen=True)
class IcpTrack:
    """A reference that several frames are laid on, and the last of them.

    planes              the reference's, an array for each level
    last                the last good frame
    T_camera_reference  4x4, of that frame
    covariance          6x6 of that motion, (translation m, rotation rad), as a small motion in the
                        last camera's axes; zero while it is the reference itself
    """

    planes: PlanePyramid
    last_frame: DepthPyramid
    T_camera_reference: Array
    covariance: Array

    def advance(self, view: DepthPyramid, alignment: IcpAlignment) -> "IcpTrack":
        """The same reference, seen from the next good frame."""
        return IcpTrack(
            self.planes, view, alignment.T_camera_reference, alignment_covariance(alignment)
        )

    def relative_motion(self, after: "IcpTrack") -> tuple[Array, Array]:
        """4x4 T_last_camera between the last frames of two tracks of one reference, and its 6x6.

        The errors of both frames count, each as seen from its own camera.
        """
        T_last_camera = self.T_camera_reference @ inverse(after.T_camera_reference)
        return T_last_camera, transport_covariance(
            self.covariance, T_last_camera
        ) + after.covariance


def start_track(view: DepthPyramid, max_planes: int) -> IcpTrack:
    """A track whose reference is this frame; at most `budget` planes of each level."""
    planes = tuple(find_planes(level, max_planes) for level in view.levels)
    return IcpTrack(planes, view, np.eye(4), np.zeros((6, 6)))


def needs_new_reference(alignment: IcpAlignment) -> bool:
    """Whether the next frames had better have a newer reference.

    A view that says little of some direction makes a poor one: the old one is kept for longer.
    """
    seen = alignment.num_in_gate / alignment.num_planes
    if seen >= RENEW_SHARE:
        return False
    return seen < MIN_SHARE or bool(alignment.degeneracy.observability[0] >= GOOD_OBSERVABILITY)
