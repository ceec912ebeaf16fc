"""Snapshots and views for a calibration: raw images without rectification."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import Distortion
from drivers.core.geometry import Array, rigid_transform, so3_exp
from vo_service.tools.calibration.board import BoardCorners, GrayImage

NO_DEPTH: NDArray[np.uint16] = np.zeros((0, 0), np.uint16)


@dataclass(frozen=True)
class Snapshot:
    """Raw images of both cameras at one time.

    Attributes:
        name: Name for people: a file, or the number of a frame.
        stamp_s: Time on any clock.
        color_bgr: (height, width, 3) uint8, distorted.
        depth_raw: (height, width) uint16, not registered; NO_DEPTH without depth.
    """

    name: str
    stamp_s: float
    color_bgr: NDArray[np.uint8]
    depth_raw: NDArray[np.uint16]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the color image."""
        return self.color_bgr.shape[1], self.color_bgr.shape[0]

    @property
    def gray(self) -> GrayImage:
        """(height, width) uint8 brightness."""
        gray: GrayImage = cv2.cvtColor(self.color_bgr, cv2.COLOR_BGR2GRAY)  # type: ignore[assignment]
        return gray


@dataclass(frozen=True)
class BoardView:
    """Snapshot of the board, without its color image."""

    name: str
    size: tuple[int, int]
    corners: BoardCorners
    depth_raw: NDArray[np.uint16]


def make_view(snapshot: Snapshot, corners: BoardCorners) -> BoardView:
    """Make a view from a snapshot and its corners."""
    return BoardView(snapshot.name, snapshot.size, corners, snapshot.depth_raw)


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


def solve_board_pose(lens: Lens, corners: BoardCorners) -> Array:
    """Return the 4x4 T_camera_board of a planar board."""
    _, rotation, translation = cv2.solvePnP(
        corners.points_m,
        corners.pixels,
        lens.K,
        np.array(lens.distortion),
        flags=cv2.SOLVEPNP_IPPE,
    )
    return rigid_transform(so3_exp(rotation.ravel()), translation.ravel())
