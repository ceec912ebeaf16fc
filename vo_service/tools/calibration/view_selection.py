"""Selection of views: snapshots with a still board at a new pose."""

import math
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import NO_DISTORTION
from drivers.core.geometry import Array
from vo_service.tools.calibration.board import NO_CORNERS, Board, BoardCorners
from vo_service.tools.calibration.snapshot import (
    BoardView,
    Lens,
    Snapshot,
    make_view,
    solve_board_pose,
)

# Half a pixel from frame to frame causes no blur; corners are accurate to a tenth.
MAX_STILL_SPEED_PX_S = 15.0
# Two images with a longer interval are photographs, not a video, so each counts as still.
MAX_VIDEO_GAP_S = 0.5
# Minimum distance of a new view from all others, with position relative to the image size,
# logarithm of the distance, and tilt in radians.
MIN_POSE_DISTANCE = 0.12
# Typical ratio of focal length and image width, for an approximate pose.
DEFAULT_FOCAL_RATIO = 525.0 / 640.0


class ViewDecision(StrEnum):
    """Decision on a snapshot; the value is an instruction for the user."""

    NO_BOARD = "show the board"
    MOVING = "hold it still"
    DUPLICATE = "move or tilt it"
    ACCEPTED = "taken"


@dataclass(frozen=True)
class BoardPose:
    """Approximate pose of the board, with a typical lens.

    Attributes:
        center: (2,) mean of the corners, relative to the image's width and height.
        distance_m: Distance of the board's center along the optical axis.
        normal: (3,) normal in optical axes, towards the camera.
    """

    center: Array
    distance_m: float
    normal: Array

    def vector(self) -> Array:
        """Return a vector (5,) for distances between poses."""
        return np.array([*self.center, math.log(self.distance_m), *self.normal[:2]])


def estimate_board_pose(view: BoardView) -> BoardPose:
    """Estimate the pose from the corners and a typical lens."""
    width, height = view.size
    focal_px = DEFAULT_FOCAL_RATIO * width
    lens = Lens(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, NO_DISTORTION)
    T_camera_board = solve_board_pose(lens, view.corners)
    board_center_m = view.corners.points_m.mean(axis=0)
    center_m = T_camera_board[:3, :3] @ board_center_m + T_camera_board[:3, 3]
    normal = T_camera_board[:3, 2] * -np.sign(T_camera_board[:3, 2] @ center_m)
    center = view.corners.pixels.mean(axis=0) / (width, height)
    return BoardPose(center, max(float(center_m[2]), 1e-3), normal)


class ViewSelector:
    """Selector of views with a still board at a new pose.

    Attributes:
        corners: Corners of the last snapshot.
        views: Accepted views.
        board_poses: Approximate pose of the board in each view.
        snapshot_count: Number of processed snapshots.
        board_count: Number of snapshots that showed the board.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._last_stamp_s = -math.inf
        self.corners = NO_CORNERS
        self.views: list[BoardView] = []
        self.board_poses: list[BoardPose] = []
        self.snapshot_count = self.board_count = 0

    def process(self, snapshot: Snapshot) -> ViewDecision:
        """Find the board, and accept the view if it is still and new."""
        self.snapshot_count += 1
        corners = self.board.find_corners(snapshot.gray)
        is_still = self._is_still(snapshot.stamp_s, corners)
        self._last_stamp_s, self.corners = snapshot.stamp_s, corners
        if not len(corners.pixels):
            return ViewDecision.NO_BOARD
        self.board_count += 1
        if not is_still:
            return ViewDecision.MOVING
        view = make_view(snapshot, corners)
        pose = estimate_board_pose(view)
        if not self._is_new(pose):
            return ViewDecision.DUPLICATE
        self.views.append(view)
        self.board_poses.append(pose)
        return ViewDecision.ACCEPTED

    def _is_still(self, stamp_s: float, corners: BoardCorners) -> bool:
        gap_s = stamp_s - self._last_stamp_s
        if gap_s > MAX_VIDEO_GAP_S:
            return True
        if not len(self.corners.pixels):
            return False
        return _median_shift_px(corners, self.corners) <= MAX_STILL_SPEED_PX_S * gap_s

    def _is_new(self, pose: BoardPose) -> bool:
        vector = pose.vector()
        return all(
            np.linalg.norm(vector - old.vector()) > MIN_POSE_DISTANCE for old in self.board_poses
        )


def _median_shift_px(corners: BoardCorners, before: BoardCorners) -> float:
    """Return the median shift of the common corners; infinite without any."""
    current, previous = _pixels_by_board_point(corners), _pixels_by_board_point(before)
    common = current.keys() & previous.keys()
    if not common:
        return math.inf
    return float(np.median([np.linalg.norm(current[key] - previous[key]) for key in common]))


def _pixels_by_board_point(corners: BoardCorners) -> dict[tuple[float, ...], Array]:
    points = [tuple(point) for point in corners.points_m.tolist()]
    return dict(zip(points, corners.pixels, strict=True))


def convex_outline(pixels: Array) -> NDArray[np.int32]:
    """Return the convex hull (K, 2) of corners, in whole pixels."""
    hull: NDArray[np.int32] = cv2.convexHull(np.rint(pixels).astype(np.int32)).reshape(-1, 2)  # type: ignore[assignment]
    return hull
