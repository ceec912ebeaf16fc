"""The robot's own body in view, which the camera sees at rest however it moves.

Where all else in view tells little, as before a bare wall, texture on it would tell that the camera
stands. Blocks of the image belong to the body if they show the same texture at the same depth as in
the keyframe before, and do not fit where the room has moved.
"""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
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
            (images.gray[0], depth.raw, depth.factor),
            (before.gray[0], before.depth.raw, before.depth.factor),
            images.intrinsics[0],
            images.depth_noise,
            (T_keyframe_camera, inverse(T_keyframe_camera)),
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


# (H / 2, W / 2) brightness, (H, W) raw depth, and its value per meter.
View = tuple[NDArray[np.uint8], NDArray[np.uint16], float]


@kernel
def _count_views(
    view: View,
    keyframe: View,
    intrinsics: Array,
    noise: float,
    motion: tuple[Array, Array],
    block_points: Array,
    views: NDArray[np.int64],
) -> None:
    """Count a view in which a block is at rest; start anew where it is not, or as the room is.

    Args:
        view: The frame.
        keyframe: The keyframe.
        intrinsics: (4,) of both.
        noise: Of the inverse depth of a pixel, 1/m.
        motion: 4x4 T_keyframe_camera and its inverse.
        block_points: (rows, columns, 3) in the camera's axes, m; z = 0 without depth.
        views: (rows, columns), in and out.
    """
    T_keyframe_camera, T_camera_keyframe = motion
    for i in range(views.shape[0]):
        for j in range(views.shape[1]):
            u, v = j * DYNAMIC_BLOCK_PX + BLOCK_CENTER_PX, i * DYNAMIC_BLOCK_PX + BLOCK_CENTER_PX
            position, there = block_points[i, j], inverse_depth(keyframe[1][v, u], keyframe[2])
            if position[2] < MIN_DEPTH_M or there == 0.0:
                continue
            w = 1.0 / position[2]
            if abs(there - w) > MAX_SAME_SURFACE_RATIO * surface_step(w, noise):
                views[i, j] = 0
                continue
            is_at_rest = _is_same_texture(view[0], u, v, keyframe[0], u, v)
            if not is_at_rest and views[i, j] == 0:
                continue
            # Outside of the keyframe: the surface that it saw here is sought in the view.
            fits = _fits_in_room(
                view[0], u, v, position, T_keyframe_camera, keyframe, intrinsics, noise
            )
            if fits < 0:
                fits = _fits_in_room(
                    keyframe[0], u, v, position, T_camera_keyframe, view, intrinsics, noise
                )
            if is_at_rest and fits == 0:
                views[i, j] += 1
            elif fits == 1 and not is_at_rest:
                views[i, j] = 0


@kernel
def _fits_in_room(
    gray: NDArray[np.uint8],
    u: int,
    v: int,
    position: Array,
    T_other: Array,
    other: View,
    intrinsics: Array,
    noise: float,
) -> int:
    """Whether another view shows the surface at pixel (u, v) where the motion puts it; -1 outside.

    Args:
        gray: (H / 2, W / 2) brightness with the surface.
        u: Column in the whole image.
        v: Row in it.
        position: (3,) of the surface in the camera's axes, m.
        T_other: 4x4 from these axes to those of the other view.
        other: The other view.
        intrinsics: (4,) of both.
        noise: Of the inverse depth of a pixel, 1/m.
    """
    x, y, z = transform_point(T_other, position[0], position[1], position[2])
    if z < MIN_DEPTH_M:
        return -1
    u_float, v_float = project(x, y, z, intrinsics)
    u_other, v_other = int(u_float + 0.5), int(v_float + 0.5)
    gray_other, depth_raw, depth_factor = other
    if not (0 <= u_other < depth_raw.shape[1] and 0 <= v_other < depth_raw.shape[0]):
        return -1
    difference = abs(inverse_depth(depth_raw[v_other, u_other], depth_factor) - 1.0 / z)
    is_same_depth = difference <= MAX_SAME_SURFACE_RATIO * surface_step(1.0 / z, noise)
    return int(is_same_depth and _is_same_texture(gray, u, v, gray_other, u_other, v_other))


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
