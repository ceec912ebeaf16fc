"""TSDF volume: depth and color of many frames, fused into one surface.

Voxels exist only near surfaces, up to a memory limit. `voxel_block_grid` stores them,
`tsdf_integration` updates them, `surface_nets` extracts the mesh.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.files import MEGABYTE
from drivers.core.geometry import Array, inverse
from vo_service.odometry.uncertainty import depth_sigma_m
from vo_service.reconstruction.mesh import Mesh, remove_small_components
from vo_service.reconstruction.surface_nets import MESH_BYTES_PER_BLOCK, extract_surface
from vo_service.reconstruction.tsdf_integration import (
    blocks_in_view,
    blocks_to_allocate,
    frustum_normals,
    integrate_frame,
)
from vo_service.reconstruction.voxel_block_grid import (
    BLOCK_BYTES,
    BLOCK_SIDE,
    TsdfConfig,
    VoxelBlockGrid,
)

# Least number of sampled rays across a block.
MIN_RAYS_PER_BLOCK = 4.0
# Standard deviation of the best readings, which have weight 1. A surface is extracted once its
# combined standard deviation is one voxel: at a weight of MIN_SIGMA_VOXELS ** 2.
MIN_SIGMA_VOXELS = 0.5
# Smaller components, up to 7 x 7 cells, are noise.
MIN_COMPONENT_TRIANGLES = 100


class TsdfVolume:
    """A map that grows with every frame up to a memory limit. Deterministic.

    At the limit, existing surfaces are still refined; new ones are left out, and `is_full` is True.
    """

    def __init__(self, config: TsdfConfig) -> None:
        """Allocate the volume.

        Raises:
            MemoryError: If there is not enough memory.
        """
        self.config = config
        bytes_per_block = BLOCK_BYTES + MESH_BYTES_PER_BLOCK
        self._blocks = VoxelBlockGrid(max(1, config.memory_mb * MEGABYTE // bytes_per_block))

    @property
    def is_full(self) -> bool:
        """Whether a block did not fit into the memory."""
        return self._blocks.rejected > 0

    @property
    def used_fraction(self) -> float:
        """Used share of the memory, 0 to 1."""
        return self._blocks.count / self._blocks.capacity

    def integrate(
        self,
        depth_m: NDArray[np.float32],
        color_bgr: NDArray[np.uint8],
        camera: PinholeCamera,
        T_world_camera: Array,
    ) -> None:
        """Fuse one frame.

        Args:
            depth_m: (H, W), 0 = no reading.
            color_bgr: (H, W, 3).
            T_world_camera: 4x4 pose.
        """
        blocks, config = self._blocks, self.config
        block_m = BLOCK_SIDE * config.voxel_m
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        T_camera_world = inverse(T_world_camera)
        near_m = np.where(depth_m <= config.max_depth_m, depth_m, np.float32(0.0))
        # Allocate blocks near the measured surface.
        block_px = block_m / config.max_depth_m * min(camera.fx, camera.fy)
        step_px = max(1, int(block_px / MIN_RAYS_PER_BLOCK))
        blocks.allocate(
            blocks_to_allocate(
                near_m, intrinsics, T_world_camera, block_m, config.truncation_m, step_px
            )
        )
        # Update every voxel in view, also the empty ones.
        coordinates = blocks.coordinates[: blocks.count]
        max_depth_m = float(depth_m.max()) + config.truncation_m
        visible_blocks = blocks_in_view(
            coordinates, frustum_normals(camera), T_camera_world, block_m, max_depth_m
        )
        integrate_frame(
            visible_blocks,
            coordinates,
            (blocks.distance_m, blocks.weight, blocks.color),
            (depth_m, self._depth_weights(depth_m), color_bgr),
            intrinsics,
            T_camera_world,
            config.voxel_m,
            config.truncation_m,
        )

    def has_depth_in_range(self, depth_m: NDArray[np.float32]) -> bool:
        """Return whether any reading can be fused."""
        return bool(np.any((depth_m > 0) & (depth_m <= self.config.max_depth_m)))

    def extract_mesh(self) -> Mesh:
        """Extract the surface that is known to one voxel, without small components."""
        surface = extract_surface(self._blocks, self.config.voxel_m, MIN_SIGMA_VOXELS**2)
        return remove_small_components(surface, MIN_COMPONENT_TRIANGLES)

    def _depth_weights(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the (H, W) weight of each reading, 1 at best; 0 without a reading."""
        # The voxel size limits the resolution, however accurate the reading is.
        best_m = MIN_SIGMA_VOXELS * self.config.voxel_m
        variance = best_m**2 + depth_sigma_m(depth_m.astype(np.float64)) ** 2
        return np.where(depth_m > 0, best_m**2 / variance, 0.0).astype(np.float32)
