"""Intrinsics and distortion of a camera, and the pose of a board by them."""

from dataclasses import dataclass

import cv2
import numpy as np

from drivers.calibration import Distortion
from drivers.core.geometry import Array, rigid_transform, so3_exp
from vo_service.tools.calibration.board import BoardCorners

# Brown's model has no closed inverse. For small distortion the error is far below a pixel.
UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 1e-12)


@dataclass(frozen=True)
class Lens:
    """Intrinsics and distortion (k1 k2 p1 p2 k3, OpenCV's order)."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion

    @property
    def K(self) -> Array:
        """3x3 intrinsics matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def vector(self) -> Array:
        """(9,) fx fy cx cy k1 k2 p1 p2 k3."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion])

    def project(self, T_camera_board: Array, points_m: Array) -> Array:
        """Return the pixels (N, 2) of points (N, 3) in board coordinates."""
        rotation = cv2.Rodrigues(T_camera_board[:3, :3])[0]
        pixels, _ = cv2.projectPoints(
            points_m, rotation, T_camera_board[:3, 3], self.K, np.array(self.distortion)
        )
        return np.asarray(pixels, np.float64).reshape(-1, 2)

    def rays(self, pixels: Array) -> Array:
        """Return the undistorted rays (N, 3) with z = 1 of pixels (N, 2): inverse of `project`."""
        xy = cv2.undistortPoints(
            pixels[:, None], self.K, np.array(self.distortion), criteria=UNDISTORT_CRITERIA
        )
        return np.column_stack([xy.reshape(-1, 2), np.ones(len(pixels))])


def solve_board_pose(lens: Lens, corners: BoardCorners) -> Array:
    """Return the 4x4 T_camera_board of a planar board."""
    _, rotation, translation = cv2.solvePnP(
        corners.points_m, corners.pixels, lens.K, np.array(lens.distortion), flags=cv2.SOLVEPNP_IPPE
    )
    return rigid_transform(so3_exp(rotation.ravel()), translation.ravel())
