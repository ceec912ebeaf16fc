"""The robot's own body in view, which the camera sees at rest however it moves.

Where all else in view tells little, as before a bare wall, texture on it would tell that the camera
stands. Blocks of the image belong to the body if they show the same texture at the same depth as in
the keyframe before, though the room moved past by many pixels and does not fit there.
"""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.dynamic_points import (
    BLOCK_CENTER_PX,
    backproject_blocks,
)
from vo_service.odometry.direct.image_pyramid import (
    ImagePyramid,
    inverse_depth,
    surface_step,
)
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import project, transform_point
from vo_service.odometry.direct.parameters import (
    DYNAMIC_BLOCK_PX,
    MAX_SAME_SURFACE_RATIO,
    MIN_BODY_CONTRAST,
    MIN_BODY_CORRELATION,
    MIN_BODY_VIEWS,
    MIN_DEPTH_M,
)


@dataclass(frozen=True)
class RobotBody:
    """Blocks of the image that show the robot's body.

    Attributes:
        views: (rows, columns) number of successive keyframes in which a block was at rest.
    """

    views: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))

    def update(
        self, images: ImagePyramid, keyframe: DirectKeyframe, T_keyframe_camera: Array
    ) -> "RobotBody":
        """Return the body, updated by a view far from a keyframe.

        Args:
            images: The frame.
            keyframe: The keyframe.
            T_keyframe_camera: 4x4.
        """
        depth, before = images.depth, keyframe.images
        if depth.raw.shape != before.depth.raw.shape:
            return RobotBody()
        _, block_points = backproject_blocks(depth.raw, depth.factor, images.intrinsics[0])
        same_size = self.views.shape == block_points.shape[:2]
        views = self.views.copy() if same_size else np.zeros(block_points.shape[:2], np.int64)
        _count_views(
            (images.gray[0], before.gray[0]),
            (before.depth.raw, before.depth.factor),
            before.intrinsics[0],
            images.depth_noise,
            T_keyframe_camera,
            block_points,
            views,
        )
        return RobotBody(views)

    @cached_property
    def blocks(self) -> NDArray[np.bool_] | None:
        """(rows, columns) which blocks show the body, with a margin of one block; None for none.

        Single blocks are at rest by chance.
        """
        is_at_rest = (self.views >= MIN_BODY_VIEWS).astype(np.uint8)
        if not is_at_rest.any():
            return None
        square = np.ones((3, 3), np.uint8)
        blocks = cv2.dilate(cv2.morphologyEx(is_at_rest, cv2.MORPH_OPEN, square), square) > 0
        return np.asarray(blocks) if blocks.any() else None


@kernel
def _count_views(
    grays: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    depth: tuple[NDArray[np.uint16], float],
    intrinsics: Array,
    noise: float,
    T_keyframe_camera: Array,
    block_points: Array,
    views: NDArray[np.int64],
) -> None:
    """Count a view in which a block is at rest; start anew where it is not, or as the room is.

    Args:
        grays: (H / 2, W / 2) brightness of the frame and of the keyframe.
        depth: (H, W) raw depth of the keyframe, 0 = no reading, and its value per meter.
        intrinsics: (4,) of both.
        noise: Of the inverse depth of a pixel, 1/m.
        T_keyframe_camera: 4x4.
        block_points: (rows, columns, 3) in the camera's axes, m; z = 0 without depth.
        views: (rows, columns), in and out.
    """
    gray, gray_before = grays
    for i in range(views.shape[0]):
        for j in range(views.shape[1]):
            x, y, z = block_points[i, j]
            if z < MIN_DEPTH_M:
                continue
            u, v = j * DYNAMIC_BLOCK_PX + BLOCK_CENTER_PX, i * DYNAMIC_BLOCK_PX + BLOCK_CENTER_PX
            x_before, y_before, z_before = transform_point(T_keyframe_camera, x, y, z)
            if z_before < MIN_DEPTH_M:
                continue
            u_float, v_float = project(x_before, y_before, z_before, intrinsics)
            u_before, v_before = int(u_float + 0.5), int(v_float + 0.5)
            if max(abs(u_before - u), abs(v_before - v)) < DYNAMIC_BLOCK_PX:
                continue
            tolerance = MAX_SAME_SURFACE_RATIO * surface_step(1.0 / z, noise)
            there = inverse_depth(depth[0][v, u], depth[1])
            if there == 0.0:
                continue
            if abs(there - 1.0 / z) > tolerance:
                views[i, j] = 0
                continue
            is_at_rest = _is_same_texture(gray, u, v, gray_before, u, v)
            if not is_at_rest and views[i, j] == 0:
                continue
            is_in_room = _is_same_depth(
                depth, u_before, v_before, 1.0 / z_before, tolerance
            ) and _is_same_texture(gray, u, v, gray_before, u_before, v_before)
            if is_at_rest and not is_in_room:
                views[i, j] += 1
            elif is_in_room and not is_at_rest:
                views[i, j] = 0


@inline_kernel
def _is_same_depth(
    depth: tuple[NDArray[np.uint16], float], u: int, v: int, w: float, tolerance: float
) -> bool:
    """Whether a raw depth image, with its value per meter, has the inverse depth w at a pixel."""
    depth_raw, depth_factor = depth
    if not (0 <= u < depth_raw.shape[1] and 0 <= v < depth_raw.shape[0]):
        return False
    return bool(abs(inverse_depth(depth_raw[v, u], depth_factor) - w) <= tolerance)


@kernel
def _is_same_texture(
    gray: NDArray[np.uint8],
    u: int,
    v: int,
    other: NDArray[np.uint8],
    u_other: int,
    v_other: int,
) -> bool:
    """Whether the brightness around two pixels correlates; not without texture, or at the border.

    Args:
        gray: (H / 2, W / 2).
        u: Column in the whole image.
        v: Row in it.
        other: (H / 2, W / 2) of the other view.
        u_other: Column in that.
        v_other: Row in that.
    """
    r, (height, width) = BLOCK_CENTER_PX, gray.shape
    row, column, row_other, column_other = v // 2, u // 2, v_other // 2, u_other // 2
    if min(row, column, row_other, column_other) < r:
        return False
    if max(row, row_other) >= height - r or max(column, column_other) >= width - r:
        return False
    count = (2 * r + 1) ** 2
    total = total_other = squared = squared_other = product = np.int64(0)
    for i in range(-r, r + 1):
        for j in range(-r, r + 1):
            a = np.int64(gray[row + i, column + j])
            b = np.int64(other[row_other + i, column_other + j])
            total, total_other = total + a, total_other + b
            squared, squared_other = squared + a * a, squared_other + b * b
            product += a * b
    variance, variance_other = count * squared - total**2, count * squared_other - total_other**2
    covariance = count * product - total * total_other
    has_texture = min(variance, variance_other) >= (count * MIN_BODY_CONTRAST) ** 2
    largest = np.sqrt(float(variance) * float(variance_other))
    return bool(has_texture and covariance >= MIN_BODY_CORRELATION * largest)
