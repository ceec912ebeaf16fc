"""A ball, as it was seen from all around and as it is: made once for all tests."""

import numpy as np
import pytest

from drivers.geometry import rigid_transform, rotation_from_vector
from tests.vo_service.mapping.scenes import CAMERA, SETTINGS, ball
from vo_service.mapping.blocks import SIDE, Blocks
from vo_service.mapping.fusion import Fusion
from vo_service.mapping.mesh import Mesh
from vo_service.mapping.surface import surface

TURNS = [(0.0, np.pi / 2 * quarter, 0.0) for quarter in range(4)]
NODS = [(sign * np.pi / 2, 0.0, 0.0) for sign in (-1, 1)]


@pytest.fixture(scope="session")
def seen_ball() -> Mesh:
    """A ball of radius 0.5 m around the origin, from 6 places 1.6 m away, in voxels of 5 cm."""
    fusion = Fusion(SETTINGS)
    for turn in (*TURNS, *NODS):
        R = rotation_from_vector(turn)
        T_world_camera = rigid_transform(R, R @ [0.0, 0.0, -1.6])
        depth_m, colour_bgr = ball(T_world_camera)
        fusion.add(depth_m, colour_bgr, CAMERA, T_world_camera)
    return fusion.mesh()


@pytest.fixture(scope="session")
def exact_ball() -> Mesh:
    """The same ball from exact distances."""
    blocks, voxel_m = Blocks(64), SETTINGS.voxel_m
    corners = np.indices((4, 4, 4)).reshape(3, -1).T - 2
    blocks.make_room(corners.astype(np.int64))
    steps = np.indices((SIDE, SIDE, SIDE)).reshape(3, -1).T
    places_m = (corners[:, None] * SIDE + steps) * voxel_m
    blocks.distance_m[:] = np.linalg.norm(places_m, axis=2) - 0.5
    blocks.weight[:] = 1.0
    return surface(blocks, voxel_m, 1.0)
