"""Integration of one frame into the TSDF: a weighted running mean of the signed distance.

Curless and Levoy, "A volumetric method for building complex models from range images", SIGGRAPH
1996. Voxels in front of the measured depth are updated as empty, which removes false surfaces and
objects that have moved away.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.reconstruction.voxel_block_grid import BLOCK_SIDE, BlockCoordinates

# Integer weight of a color for a reading of weight 1, and the greatest sum.
COLOR_WEIGHT_SCALE = 64.0
MAX_COLOR_WEIGHT = 65535

DepthImage = NDArray[np.float32]
ColorImage = NDArray[np.uint8]


@kernel
def blocks_to_allocate(
    depth_m: DepthImage,
    intrinsics: Array,
    T_world_camera: Array,
    block_m: float,
    margin_m: float,
    step_px: int,
) -> BlockCoordinates:
    """List the blocks near the measured surface.

    Args:
        depth_m: (H, W), 0 = no reading.
        intrinsics: Values fx, fy, cx, cy, pixels.
        T_world_camera: 4x4 pose.
        margin_m: Distance from the surface, along the ray.
        step_px: Spacing of the sampled pixels.

    Returns:
        (N, 3) block coordinates, with duplicates.
    """
    height, width = depth_m.shape
    steps = 1 + math.ceil(2.0 * margin_m / (0.5 * block_m))
    rays = ((height - 1) // step_px + 1) * ((width - 1) // step_px + 1)
    blocks = np.empty((rays * (steps + 1), 3), np.int64)
    n = 0
    T = T_world_camera
    for v in range(0, height, step_px):
        for u in range(0, width, step_px):
            surface_m = float(depth_m[v, u])
            if surface_m <= 0.0:
                continue
            x = (u - intrinsics[2]) / intrinsics[0]
            y = (v - intrinsics[3]) / intrinsics[1]
            for s in range(steps + 1):
                z = surface_m + margin_m * (2.0 * s / steps - 1.0)
                bx = math.floor((T[0, 3] + z * (T[0, 0] * x + T[0, 1] * y + T[0, 2])) / block_m)
                by = math.floor((T[1, 3] + z * (T[1, 0] * x + T[1, 1] * y + T[1, 2])) / block_m)
                bz = math.floor((T[2, 3] + z * (T[2, 0] * x + T[2, 1] * y + T[2, 2])) / block_m)
                if n and (
                    blocks[n - 1, 0] == bx and blocks[n - 1, 1] == by and blocks[n - 1, 2] == bz
                ):
                    continue
                blocks[n, 0], blocks[n, 1], blocks[n, 2] = bx, by, bz
                n += 1
    return blocks[:n]


def frustum_normals(camera: PinholeCamera) -> Array:
    """Compute the (4, 3) inward unit normals of the frustum's side planes, in camera axes."""
    left, right = camera.cx + 0.5, camera.width - 0.5 - camera.cx
    top, bottom = camera.cy + 0.5, camera.height - 0.5 - camera.cy
    inwards = np.array(
        [
            [camera.fx, 0.0, left],
            [-camera.fx, 0.0, right],
            [0.0, camera.fy, top],
            [0.0, -camera.fy, bottom],
        ]
    )
    normals: Array = inwards / np.linalg.norm(inwards, axis=1, keepdims=True)
    return normals


@kernel
def blocks_in_view(
    coordinates: BlockCoordinates,
    frustum: Array,
    T_camera_world: Array,
    block_m: float,
    max_depth_m: float,
) -> NDArray[np.int64]:
    """List the blocks that may be in view.

    Args:
        coordinates: (M, 3) of all blocks.
        frustum: (4, 3) normals from `frustum_normals`.
        T_camera_world: 4x4.
        max_depth_m: Greatest depth along the optical axis.

    Returns:
        (N,) block numbers.
    """
    visible = np.empty(len(coordinates), np.int64)
    n = 0
    radius_m = 0.5 * math.sqrt(3.0) * block_m
    T = T_camera_world
    p = np.empty(3)
    for b in range(len(coordinates)):
        for i in range(3):
            p[i] = T[i, 3]
            for j in range(3):
                p[i] += T[i, j] * (coordinates[b, j] + 0.5) * block_m
        if p[2] < -radius_m or p[2] > max_depth_m + radius_m:
            continue
        is_inside = True
        for side in range(4):
            distance_m = frustum[side, 0] * p[0] + frustum[side, 1] * p[1] + frustum[side, 2] * p[2]
            is_inside = is_inside and distance_m > -radius_m
        if is_inside:
            visible[n] = b
            n += 1
    return visible[:n]


@kernel
def integrate_frame(
    visible_blocks: NDArray[np.int64],
    coordinates: BlockCoordinates,
    voxels: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]],
    images: tuple[DepthImage, DepthImage, ColorImage],
    intrinsics: Array,
    T_camera_world: Array,
    voxel_m: float,
    truncation_m: float,
) -> None:
    """Integrate one frame into the visible blocks.

    Args:
        visible_blocks: (N,) block numbers.
        coordinates: (M, 3) of all blocks.
        voxels: Distance, weight and color of `VoxelBlockGrid`, updated in place.
        images: Depth (H, W), weight of each reading (H, W), and BGR (H, W, 3).
        intrinsics: Values fx, fy, cx, cy, pixels.
        T_camera_world: 4x4.
        truncation_m: Voxels further behind the surface are not updated.
    """
    distance_m, weight, color = voxels
    depth_m, reading_weight, color_bgr = images
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    T = T_camera_world
    along = T[:3, 2] * voxel_m  # step from one voxel to the next in memory, camera axes
    for b in visible_blocks:
        for row in range(BLOCK_SIDE * BLOCK_SIDE):
            wx = (coordinates[b, 0] * BLOCK_SIDE + row // BLOCK_SIDE) * voxel_m
            wy = (coordinates[b, 1] * BLOCK_SIDE + row % BLOCK_SIDE) * voxel_m
            wz = coordinates[b, 2] * BLOCK_SIDE * voxel_m
            x0 = T[0, 0] * wx + T[0, 1] * wy + T[0, 2] * wz + T[0, 3]
            y0 = T[1, 0] * wx + T[1, 1] * wy + T[1, 2] * wz + T[1, 3]
            z0 = T[2, 0] * wx + T[2, 1] * wy + T[2, 2] * wz + T[2, 3]
            for k in range(BLOCK_SIDE):
                z = z0 + k * along[2]
                if z <= 0.0:
                    continue
                u = math.floor(fx * (x0 + k * along[0]) / z + cx + 0.5)
                v = math.floor(fy * (y0 + k * along[1]) / z + cy + 0.5)
                if u < 0 or v < 0 or u >= width or v >= height:
                    continue
                w = reading_weight[v, u]
                in_front_m = depth_m[v, u] - z
                if w <= 0.0 or in_front_m < -truncation_m:
                    continue
                voxel = row * BLOCK_SIDE + k
                before = weight[b, voxel]
                share = w / (before + w)
                weight[b, voxel] = before + w
                distance_m[b, voxel] += share * (
                    min(in_front_m, truncation_m) - distance_m[b, voxel]
                )
                # The color belongs to the surface, not to empty voxels in front of it.
                if in_front_m < truncation_m:
                    _blend_color(color, b, voxel, color_bgr, v, u, w)


@inline_kernel
def _blend_color(
    color: NDArray[np.uint16], b: int, voxel: int, color_bgr: ColorImage, v: int, u: int, w: float
) -> None:
    """Blend a pixel's color into the mean, which has its own weight."""
    parts = math.ceil(COLOR_WEIGHT_SCALE * w)
    total = min(MAX_COLOR_WEIGHT, color[b, voxel, 3] + parts)
    color[b, voxel, 3] = total
    for channel in range(3):
        old = color[b, voxel, channel]
        new = 256.0 * color_bgr[v, u, 2 - channel]
        color[b, voxel, channel] = np.uint16(old + parts / total * (new - old) + 0.5)
