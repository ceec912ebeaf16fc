"""Synthetic Kinect in front of a board, with distortion, blur, noise and disparity."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from vo_service.tools.calibration.board import Board, BoardCorners
from vo_service.tools.calibration.lens import Lens
from vo_service.tools.calibration.snapshot import NO_DEPTH, BoardView, Snapshot

SIZE = (640, 480)
TEXELS_PER_SQUARE = 48
PAPER_SQUARES = 1  # white margin around the pattern
WALL_M = 2.6
FOCAL_TIMES_BASELINE = 575.8 * 0.075  # disparity in pixels = this / depth
DISPARITY_SIGMA_PX = 1.4e-3 * FOCAL_TIMES_BASELINE
NOISE_BLUR_PX = 1.2  # errors of neighbors are correlated
SUPERSAMPLING = 2

COLOR_LENS = Lens(531.2, 528.4, 317.1, 248.3, (0.21, -0.55, -0.002, 0.0015, 0.35))
DEPTH_LENS = Lens(586.0, 583.0, 313.0, 243.0, (0.0, 0.0, 0.0, 0.0, 0.0))
T_COLOR_DEPTH = rigid_transform(so3_exp([0.010, -0.008, 0.006]), [-0.0252, 0.0008, -0.002])


@dataclass(frozen=True)
class RenderedKinect:
    """Two cameras and the depth noise; `depth_scale` is true distance per measured distance."""

    color: Lens = COLOR_LENS
    depth: Lens = DEPTH_LENS
    depth_scale: float = 1.006
    noise_gray: float = 2.0
    T_color_depth: Array = field(default_factory=T_COLOR_DEPTH.copy)

    def take_snapshot(
        self, board: Board, T_color_board: Array, seed: int, with_depth: bool = False
    ) -> Snapshot:
        """Render the board, one second after the snapshot of the previous seed."""
        rng = np.random.default_rng(seed)
        color = self._color_image(board, T_color_board, rng)
        depth = self._depth_image(board, T_color_board, rng) if with_depth else NO_DEPTH
        return Snapshot(f"view {seed}", float(seed), color, depth)

    def make_views(self, board: Board, poses: Sequence[Array]) -> list[BoardView]:
        """Make views with rendered depth and true corners with 0.05 px of noise."""
        rng = np.random.default_rng(1)
        points_m = board.layout.inner_corners_m
        views = []
        for number, T in enumerate(poses):
            pixels = self.color.project(T, points_m) + rng.normal(0, 0.05, (len(points_m), 2))
            corners = BoardCorners(pixels, points_m)
            depth_raw = self._depth_image(board, T, rng)
            views.append(BoardView(f"view {number}", SIZE, corners, depth_raw))
        return views

    def _color_image(
        self, board: Board, T_color_board: Array, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        _, on_board_m = _intersect_board(self._color_rays, T_color_board)
        texels_m = board.layout.square_m / TEXELS_PER_SQUARE
        texels = on_board_m / texels_m + PAPER_SQUARES * TEXELS_PER_SQUARE - 0.5
        fine = cv2.remap(
            _texture(board),
            texels[..., 0].astype(np.float32),
            texels[..., 1].astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(120,),
        )
        image = cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(image, (0, 0), 0.7).astype(np.float64)
        noisy = blurred + self.noise_gray * rng.standard_normal(blurred.shape)
        gray = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return np.dstack([gray] * 3)

    def _depth_image(
        self, board: Board, T_color_board: Array, rng: np.random.Generator
    ) -> NDArray[np.uint16]:
        z_m, on_board_m = _intersect_board(
            self._depth_rays, inverse(self.T_color_depth) @ T_color_board
        )
        layout, paper_m = board.layout, PAPER_SQUARES * board.layout.square_m
        x, y = on_board_m[..., 0], on_board_m[..., 1]
        inside = (x > -paper_m) & (x < layout.width_m + paper_m) & (y > -paper_m)
        inside &= (y < layout.height_m + paper_m) & (z_m > 0)
        readings_m = np.where(inside, z_m, WALL_M) / self.depth_scale
        white_noise = rng.standard_normal(readings_m.shape).astype(np.float32)
        # A Gaussian with standard deviation s keeps 1 / (4 pi s^2) of the power of white noise.
        noise = (
            cv2.GaussianBlur(white_noise, (0, 0), NOISE_BLUR_PX)
            * 2
            * np.sqrt(np.pi)
            * NOISE_BLUR_PX
        )
        disparity_px = FOCAL_TIMES_BASELINE / readings_m + DISPARITY_SIGMA_PX * noise
        quantized_px = np.rint(8 * disparity_px) / 8
        depth_mm: NDArray[np.uint16] = np.rint(1000.0 * FOCAL_TIMES_BASELINE / quantized_px).astype(
            np.uint16
        )
        return depth_mm

    @cached_property
    def _color_rays(self) -> Array:
        return _rays(self.color, SUPERSAMPLING)

    @cached_property
    def _depth_rays(self) -> Array:
        return _rays(self.depth, 1)


def random_board_poses(
    board: Board, count: int, seed: int = 0, tilt_rad: float = 0.75
) -> list[Array]:
    """Return random T_color_board with the whole board in the image."""
    rng = np.random.default_rng(seed)
    poses: list[Array] = []
    while len(poses) < count:
        tilt = so3_exp([*rng.uniform(-tilt_rad, tilt_rad, 2), 0.0])
        R = tilt @ so3_exp([0.0, 0.0, rng.uniform(-0.4, 0.4)])
        pixel = np.array([*rng.uniform((60, 60), (580, 420)), 1.0])
        center_m = np.linalg.inv(COLOR_LENS.K) @ pixel * rng.uniform(0.45, 1.2)
        T = rigid_transform(R, center_m - R @ board.layout.inner_rectangle_m.mean(axis=0))
        pixels = COLOR_LENS.project(T, board.layout.inner_corners_m)
        if pixels.min() > 12 and np.all(pixels < np.array(SIZE) - 12):
            poses.append(T)
    return poses


def take_snapshots(
    board: Board,
    poses: Sequence[Array],
    with_depth: bool = False,
    kinect: RenderedKinect | None = None,
) -> list[Snapshot]:
    """Take one snapshot per second."""
    camera = kinect or RenderedKinect()
    return [camera.take_snapshot(board, T, seed, with_depth) for seed, T in enumerate(poses)]


@lru_cache(maxsize=8)
def _rays(lens: Lens, fineness: int) -> Array:
    """Return rays (height, width, 3) with z = 1 at `fineness` times the resolution."""
    width, height = SIZE
    v, u = np.mgrid[0 : height * fineness, 0 : width * fineness].astype(np.float64)
    pixels = (np.stack([u.ravel(), v.ravel()], axis=1) + 0.5) / fineness - 0.5
    exact = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)
    undistorted = cv2.undistortPoints(
        pixels[:, None], lens.K, np.array(lens.distortion), criteria=exact
    )
    xy = np.asarray(undistorted, np.float64).reshape(height * fineness, width * fineness, 2)
    return np.dstack([xy, np.ones(xy.shape[:2])])


def _intersect_board(rays: Array, T_camera_board: Array) -> tuple[Array, Array]:
    """Return depth, m, and board coordinates (height, width, 3) where rays meet the board."""
    normal = T_camera_board[:3, 2]
    z_m = (normal @ T_camera_board[:3, 3]) / (rays @ normal)
    T_board_camera = inverse(T_camera_board)
    on_board_m = (rays * z_m[..., None]) @ T_board_camera[:3, :3].T + T_board_camera[:3, 3]
    return z_m, on_board_m


def _texture(board: Board) -> NDArray[np.uint8]:
    """Render the printed board with its white margin."""
    layout, margin = board.layout, PAPER_SQUARES
    shape = (layout.rows + 2 * margin, layout.columns + 2 * margin)
    image = np.full((shape[0] * TEXELS_PER_SQUARE, shape[1] * TEXELS_PER_SQUARE), 230, np.uint8)
    scale = TEXELS_PER_SQUARE / layout.square_m
    for x, y, width, height in board.dark_cells_m() * scale + [
        margin * TEXELS_PER_SQUARE,
        margin * TEXELS_PER_SQUARE,
        0,
        0,
    ]:
        rows = slice(round(y), round(y + height))
        image[rows, round(x) : round(x + width)] = 25
    return image
