"""What is carried from frame to frame: a reference, and where the last good camera is from it."""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, carried, inverse
from vo_service.odometry.directions import KNOWN
from vo_service.odometry.icp.alignment import Alignment, Planes
from vo_service.odometry.icp.confidence import covariance
from vo_service.odometry.icp.planes import find_planes
from vo_service.odometry.icp.pyramid import DepthPyramid

# A reference is replaced when less than this share of its planes is seen, ...
RENEW_SEEN = 0.75
# ... but while the view says little of some direction, only when it is less than this.
KEEP_SEEN = 0.5
CLEAR = 2.0 * KNOWN


@dataclass(frozen=True)
class Track:
    """A reference that several frames are laid on, and the last of them.

    planes              the reference's, an array for each level
    last                the last good frame
    T_camera_reference  4x4, of that frame
    covariance          6x6 of that motion, (translation m, rotation rad), as a small motion in the
                        last camera's axes; zero while it is the reference itself
    """

    planes: Planes
    last: DepthPyramid
    T_camera_reference: Array
    covariance: Array

    def moved(self, view: DepthPyramid, found: Alignment) -> "Track":
        """The same reference, seen from the next good frame."""
        return Track(self.planes, view, found.T_camera_reference, covariance(found))

    def step_to(self, after: "Track") -> tuple[Array, Array]:
        """4x4 T_last_camera between the last frames of two tracks of one reference, and its 6x6.

        The errors of both frames count, each as seen from its own camera.
        """
        T_last_camera = self.T_camera_reference @ inverse(after.T_camera_reference)
        return T_last_camera, carried(self.covariance, T_last_camera) + after.covariance


def track_from(view: DepthPyramid, budget: int) -> Track:
    """A track whose reference is this frame; at most `budget` planes of each level."""
    planes = tuple(find_planes(level, budget) for level in view.levels)
    return Track(planes, view, np.eye(4), np.zeros((6, 6)))


def is_used_up(found: Alignment) -> bool:
    """Whether the next frames had better have a newer reference.

    A view that says little of some direction makes a poor one: the old one is kept for longer.
    """
    seen = found.seen / found.planes
    if seen >= RENEW_SEEN:
        return False
    return seen < KEEP_SEEN or bool(found.directions.clarity[0] >= CLEAR)
