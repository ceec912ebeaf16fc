"""Small images of known shapes, for the tests of maps."""

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig

CAMERA = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)
RED, BLUE = (0, 0, 200), (220, 30, 10)
SETTINGS = TsdfConfig(voxel_m=0.05, memory_mb=20)

Depth = NDArray[np.float32]


def pixel_rays() -> Array:
    """(48, 64, 3) directions of the pixels in the camera's axes, 1 along the optical axis."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return np.dstack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)])


def render_wall(
    distance_m: float, color: tuple[int, int, int] = RED
) -> tuple[Depth, NDArray[np.uint8]]:
    """Depth and color of a wall across the optical axis."""
    size = CAMERA.height, CAMERA.width
    return np.full(size, distance_m, np.float32), np.full((*size, 3), color, np.uint8)


def render_ball(
    T_world_camera: Array, radius_m: float = 0.5, color: tuple[int, int, int] = BLUE
) -> tuple[Depth, NDArray[np.uint8]]:
    """Depth and color of a ball at the world's origin, and nothing else."""
    directions = pixel_rays() @ T_world_camera[:3, :3].T
    camera_position = T_world_camera[:3, 3]
    a = np.sum(directions**2, axis=2)
    half_b = directions @ camera_position
    root = half_b**2 - a * (camera_position @ camera_position - radius_m**2)
    depth = np.where(root > 0, (-half_b - np.sqrt(np.maximum(root, 0.0))) / a, 0.0)
    return depth.astype(np.float32), np.full((*depth.shape, 3), color, np.uint8)


def fuse_views(
    *views: tuple[Depth, NDArray[np.uint8]], settings: TsdfConfig = SETTINGS
) -> TsdfVolume:
    """Fuse views of a camera at the world's origin."""
    volume = TsdfVolume(settings)
    for depth_m, color_bgr in views:
        volume.integrate(depth_m, color_bgr, CAMERA, np.eye(4))
    return volume
