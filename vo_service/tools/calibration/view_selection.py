"""Selection of views with a still board at a new pose, and gaps in their coverage."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import NO_DISTORTION
from drivers.core.geometry import Array
from vo_service.tools.calibration.board import NO_CORNERS, Board, BoardCorners
from vo_service.tools.calibration.lens import Lens, solve_board_pose
from vo_service.tools.calibration.snapshot import BoardView, Snapshot

# Half a pixel from frame to frame causes no blur; corners are accurate to a tenth.
MAX_STILL_SPEED_PX_S = 15.0
# Two images with a longer interval are photographs, not a video, so each counts as still.
MAX_VIDEO_GAP_S = 0.5
# Minimum distance of a new view from all others, with position relative to the image size,
# logarithm of the distance, and tilt in radians.
MIN_POSE_DISTANCE = 0.12
# Typical ratio of focal length and image width, for an approximate pose.
DEFAULT_FOCAL_RATIO = 525.0 / 640.0
# Distortion is known only where corners were seen. The image has three by three zones with narrow
# outer ones.
ZONES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)
ZONE_EDGES = (0.25, 0.75)
MIN_ZONE_CORNERS = 6
# Sine of a tilt of 20 degrees, and the number of views with this tilt in each direction.
MIN_TILT_SIN = 0.34
MIN_TILTED_VIEWS = 2
# Minimum ratio of the largest to the smallest distance, to separate scale and offset.
MIN_DISTANCE_RATIO = 1.5

EDGE_TILTS: dict[str, Callable[[Array], float]] = {
    "left": lambda normal: float(normal[0]),
    "right": lambda normal: -float(normal[0]),
    "top": lambda normal: float(normal[1]),
    "bottom": lambda normal: -float(normal[1]),
}


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
        board_poses: Approximate pose of the board in each accepted view.
        board_count: Number of snapshots that showed the board.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._last_stamp_s = -math.inf
        self.corners = NO_CORNERS
        self.views: list[BoardView] = []
        self.board_poses: list[BoardPose] = []
        self.board_count = 0

    def process(self, snapshot: Snapshot) -> ViewDecision:
        """Find the board, and accept the view if it is still and new."""
        corners = self.board.find_corners(snapshot.gray)
        is_still = self._is_still(snapshot.stamp_s, corners)
        self._last_stamp_s, self.corners = snapshot.stamp_s, corners
        if not len(corners.pixels):
            return ViewDecision.NO_BOARD
        self.board_count += 1
        if not is_still:
            return ViewDecision.MOVING
        view = BoardView(snapshot.name, snapshot.size, corners, snapshot.depth_raw)
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


@dataclass(frozen=True)
class CoverageGap:
    """Gap in the coverage, and how to fill it."""

    problem: str
    remedy: str


def count_zone_corners(views: Sequence[BoardView]) -> Array:
    """Return the number of corners (3, 3) in each zone of the image."""
    counts = np.zeros((3, 3))
    for view in views:
        column, row = np.digitize(view.corners.pixels / view.size, ZONE_EDGES).T
        np.add.at(counts, (row, column), 1)
    return counts


def find_coverage_gaps(
    views: Sequence[BoardView], board_poses: Sequence[BoardPose], with_depth: bool
) -> list[CoverageGap]:
    """Return the gaps in order of importance; `with_depth` if both cameras are calibrated."""
    gaps = [*_tilt_gaps(board_poses), *_zone_gaps(views)]
    return [*gaps, *_distance_gaps(board_poses)] if with_depth else gaps


def _zone_gaps(views: Sequence[BoardView]) -> list[CoverageGap]:
    counts = count_zone_corners(views)
    empty = [ZONES[row][column] for row, column in np.argwhere(counts < MIN_ZONE_CORNERS)]
    return [
        CoverageGap(f"no corners at the {zone} of the image", f"show it at the {zone} of the image")
        for zone in empty
    ]


def _tilt_gaps(board_poses: Sequence[BoardPose]) -> list[CoverageGap]:
    return [
        CoverageGap(
            f"too few views with the board's {edge} edge tilted towards the camera",
            f"tilt its {edge} edge 20 to 45 degrees towards the camera",
        )
        for edge, tilt in EDGE_TILTS.items()
        if sum(tilt(pose.normal) > MIN_TILT_SIN for pose in board_poses) < MIN_TILTED_VIEWS
    ]


def _distance_gaps(board_poses: Sequence[BoardPose]) -> list[CoverageGap]:
    distances_m = [pose.distance_m for pose in board_poses] or [1.0]
    if max(distances_m) > MIN_DISTANCE_RATIO * min(distances_m):
        return []
    return [
        CoverageGap(
            f"all views are {min(distances_m):.1f} to {max(distances_m):.1f} m away",
            "hold it nearer (0.6 m) and farther (1.5 m)",
        )
    ]


class CoverageGuide:
    """Guide of the user: gives instructions until the views are complete."""

    def __init__(self, selector: ViewSelector, view_count: int, with_depth: bool) -> None:
        """Set the aim; `with_depth` if both cameras are calibrated."""
        self._selector = selector
        self._view_count = view_count
        self._with_depth = with_depth

    @property
    def gaps(self) -> list[CoverageGap]:
        """Gaps of the views so far."""
        return find_coverage_gaps(
            self._selector.views, self._selector.board_poses, self._with_depth
        )

    @property
    def is_complete(self) -> bool:
        """Whether there are enough views without gaps."""
        return len(self._selector.views) >= self._view_count and not self.gaps

    def instruction(self, decision: ViewDecision) -> str:
        """Return one line after a snapshot: "12 of 25 views; show it at the top right"."""
        count = len(self._selector.views)
        views = (
            f"{count} of {self._view_count} views" if count < self._view_count else f"{count} views"
        )
        note = "" if decision is ViewDecision.ACCEPTED else f" [{decision}]"
        if self.is_complete:
            return f"{views}: enough"
        gaps = self.gaps
        remedy = gaps[0].remedy if gaps else "continue, each view a little different"
        return f"{views}; {remedy}{note}"
