"""Shared fixtures of the mapper tests."""

import numpy as np
import pytest

from tests.vo_service.slam.mapper.wall_sequence import CAMERA, COARSE
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig


@pytest.fixture(scope="session")
def kernels() -> None:
    """Compile the kernels of the fusion."""
    fusion = TsdfVolume(TsdfConfig(COARSE.voxel_m, COARSE.mesh_memory_mb))
    shape = (CAMERA.height, CAMERA.width)
    color = np.zeros((*shape, 3), np.uint8)
    fusion.integrate(np.full(shape, 2.0, np.float32), color, CAMERA, np.eye(4))
    assert len(fusion.extract_mesh().triangles)
