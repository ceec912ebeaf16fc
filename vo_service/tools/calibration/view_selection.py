"""Which snapshots become views: the board is still in them and not where it has been before."""

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

# Half a pixel from frame to frame blurs nothing; corners are found to a tenth.
MAX_STILL_SPEED_PX_S = 15.0
# Two images further apart than this are photographs, not a film: each may be still.
MAX_VIDEO_GAP_S = 0.5
# A new view is this far from all others: in parts of the image's diagonal for the place and the
# size, in radians of tilt.
MIN_POSE_DISTANCE = 0.12
# The usual focal length over the image's width, for a rough pose.
DEFAULT_FOCAL_RATIO = 525.0 / 640.0


class ViewDecision(StrEnum):
    """What became of a snapshot, as something to do for whoever holds the board."""

    NO_BOARD = "show the board"
    MOVING = "hold it still"
    DUPLICATE = "move or tilt it"
    ACCEPTED = "taken"


@dataclass(frozen=True)
class BoardPose:
    """How the board stood, roughly: the lens is not known yet.

    centre    (2,) of its corners, in parts of the image's width and height
    distance  of its centre along the axis, metres
    normal    (3,) in camera axes, towards the camera
    """

    center: Array
    distance_m: float
    normal: Array

    def vector(self) -> Array:
        """(5,) for distances between stances."""
        return np.array([*self.center, math.log(self.distance_m), *self.normal[:2]])


def estimate_board_pose(view: BoardView) -> BoardPose:
    """From the corners and a usual lens."""
    width, height = view.size
    focal_px = DEFAULT_FOCAL_RATIO * width
    lens = Lens(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, NO_DISTORTION)
    T_camera_board = solve_board_pose(lens, view.corners)
    middle_m = view.corners.points_m.mean(axis=0)
    centre_m = T_camera_board[:3, :3] @ middle_m + T_camera_board[:3, 3]
    normal = T_camera_board[:3, 2] * -np.sign(T_camera_board[:3, 2] @ centre_m)
    centre = view.corners.pixels.mean(axis=0) / (width, height)
    return BoardPose(centre, max(float(centre_m[2]), 1e-3), normal)


class ViewSelector:
    """Takes snapshots one after another and keeps the views that tell something new.

    corners   of the snapshot offered last
    views     that were kept, each with its
    stances     rough place
    offered   how many snapshots were looked at, and
    showing     how many of them showed the board
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._last_stamp_s = -math.inf
        self.corners = NO_CORNERS
        self.views: list[BoardView] = []
        self.board_poses: list[BoardPose] = []
        self.snapshot_count = self.board_count = 0

    def process(self, snapshot: Snapshot) -> ViewDecision:
        """Look for the board; keep the view if it is still and new."""
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
        found = estimate_board_pose(view)
        if not self._is_new(found):
            return ViewDecision.DUPLICATE
        self.views.append(view)
        self.board_poses.append(found)
        return ViewDecision.ACCEPTED

    def _is_still(self, stamp_s: float, corners: BoardCorners) -> bool:
        gap_s = stamp_s - self._last_stamp_s
        if gap_s > MAX_VIDEO_GAP_S:
            return True
        if not len(self.corners.pixels):
            return False
        return _median_shift_px(corners, self.corners) <= MAX_STILL_SPEED_PX_S * gap_s

    def _is_new(self, found: BoardPose) -> bool:
        here = found.vector()
        return all(
            np.linalg.norm(here - old.vector()) > MIN_POSE_DISTANCE for old in self.board_poses
        )


def _median_shift_px(corners: BoardCorners, before: BoardCorners) -> float:
    """The median way of the corners that both have; infinite without any."""
    now, then = _pixels_by_board_point(corners), _pixels_by_board_point(before)
    both = now.keys() & then.keys()
    if not both:
        return math.inf
    return float(np.median([np.linalg.norm(now[key] - then[key]) for key in both]))


def _pixels_by_board_point(corners: BoardCorners) -> dict[tuple[float, ...], Array]:
    places = [tuple(point) for point in corners.points_m.tolist()]
    return dict(zip(places, corners.pixels, strict=True))


def convex_outline(pixels: Array) -> NDArray[np.int32]:
    """(K, 2) the convex hull of corners, in whole pixels."""
    hull: NDArray[np.int32] = cv2.convexHull(np.rint(pixels).astype(np.int32)).reshape(-1, 2)  # type: ignore[assignment]
    return hull
