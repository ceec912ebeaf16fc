"""Meshes of a ball, from depth images and from exact distances, made once for all tests."""

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.reconstruction.scenes import CAMERA, SETTINGS, render_ball
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.surface_nets import extract_surface
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import BLOCK_SIDE, VoxelBlockGrid

BALL_YAWS = [(0.0, np.pi / 2 * quarter, 0.0) for quarter in range(4)]
BALL_PITCHES = [(sign * np.pi / 2, 0.0, 0.0) for sign in (-1, 1)]


@pytest.fixture(scope="session")
def seen_ball() -> Mesh:
    """A ball of radius 0.5 m at the origin, from 6 views at 1.6 m, in voxels of 5 cm."""
    volume = TsdfVolume(SETTINGS)
    for rotation in (*BALL_YAWS, *BALL_PITCHES):
        R = so3_exp(rotation)
        T_world_camera = rigid_transform(R, R @ [0.0, 0.0, -1.6])
        depth_m, color_bgr = render_ball(T_world_camera)
        volume.integrate(depth_m, color_bgr, CAMERA, T_world_camera)
    return volume.extract_mesh()


@pytest.fixture(scope="session")
def exact_ball() -> Mesh:
    """The same ball from exact distances."""
    blocks, voxel_m = VoxelBlockGrid(64), SETTINGS.voxel_m
    corners = np.indices((4, 4, 4)).reshape(3, -1).T - 2
    blocks.allocate(corners.astype(np.int64))
    steps = np.indices((BLOCK_SIDE, BLOCK_SIDE, BLOCK_SIDE)).reshape(3, -1).T
    voxels_m = (corners[:, None] * BLOCK_SIDE + steps) * voxel_m
    blocks.distance_m[:] = np.linalg.norm(voxels_m, axis=2) - 0.5
    blocks.weight[:] = 1.0
    return extract_surface(blocks, voxel_m, 1.0)
