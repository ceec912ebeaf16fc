"""Depth and color of many frames, fused into one surface.

A truncated signed distance in voxels that exist only near surfaces, and only so many of them:
`blocks.py` keeps them, `integrate.py` fills them, `surface.py` makes the mesh.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, inverse
from vo_service.config_tables import MEGABYTE
from vo_service.odometry.depth_noise import depth_sigma_m
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.mesh_cleanup import remove_small_components
from vo_service.reconstruction.surface_nets import MESH_BYTES_PER_BLOCK, extract_surface
from vo_service.reconstruction.tsdf_config import TsdfConfig
from vo_service.reconstruction.tsdf_integration import (
    blocks_in_view,
    blocks_to_allocate,
    frustum_normals,
    integrate_frame,
)
from vo_service.reconstruction.voxel_block_grid import BLOCK_BYTES, BLOCK_SIDE, VoxelBlockGrid

# A ray for at least every so many in the width of a block.
MIN_RAYS_PER_BLOCK = 4.0
# Standard deviation of the best of readings. A surface is known well enough to be drawn when all
# readings of it together are as good as one voxel: a weight of BEST_VOXELS ** 2.
MIN_SIGMA_VOXELS = 0.5
# Smaller parts of the surface hang in the air by mistake: of 7 x 7 cells.
MIN_COMPONENT_TRIANGLES = 100


class TsdfVolume:
    """A map that grows with every frame, up to a bound. Repeats bit for bit.

    Where the bound is reached, what is there already goes on being refined; what is new is left
    out, and `is_disk_full` says so.
    """

    def __init__(self, config: TsdfConfig) -> None:
        """Raises MemoryError if the system refuses the memory."""
        self.config = config
        of_each = BLOCK_BYTES + MESH_BYTES_PER_BLOCK
        self._blocks = VoxelBlockGrid(max(1, config.memory_mb * MEGABYTE // of_each))

    @property
    def is_full(self) -> bool:
        """Whether something was left out for want of memory."""
        return self._blocks.rejected > 0

    @property
    def used_fraction(self) -> float:
        """How much of the memory is used, 0 to 1."""
        return self._blocks.count / self._blocks.capacity

    def integrate(
        self,
        depth_m: NDArray[np.float32],
        color_bgr: NDArray[np.uint8],
        camera: PinholeCamera,
        T_world_camera: Array,
    ) -> None:
        """Fuse one frame: depth (H, W) in metres, 0 = no reading, and color (H, W, 3)."""
        blocks, settings = self._blocks, self.config
        block_m = BLOCK_SIDE * settings.voxel_m
        focal_centre = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        T_camera_world = inverse(T_world_camera)
        near_m = np.where(depth_m <= settings.max_depth_m, depth_m, np.float32(0.0))
        # Room for what is seen.
        across_px = block_m / settings.max_depth_m * min(camera.fx, camera.fy)
        step_px = max(1, int(across_px / MIN_RAYS_PER_BLOCK))
        blocks.allocate(
            blocks_to_allocate(
                near_m, focal_centre, T_world_camera, block_m, settings.truncation_m, step_px
            )
        )
        # Every voxel in view, whether there is a surface or nothing.
        coordinates = blocks.coordinates[: blocks.count]
        reach_m = float(depth_m.max()) + settings.truncation_m
        seen = blocks_in_view(
            coordinates, frustum_normals(camera), T_camera_world, block_m, reach_m
        )
        integrate_frame(
            seen,
            coordinates,
            (blocks.distance_m, blocks.weight, blocks.color),
            (depth_m, self._depth_weights(depth_m), color_bgr),
            focal_centre,
            T_camera_world,
            settings.voxel_m,
            settings.truncation_m,
        )

    def has_depth_in_range(self, depth_m: NDArray[np.float32]) -> bool:
        """Whether there is anything in these readings to fuse."""
        return bool(np.any((depth_m > 0) & (depth_m <= self.config.max_depth_m)))

    def extract_mesh(self) -> Mesh:
        """The surface as far as it is known to a voxel, without specks."""
        found = extract_surface(self._blocks, self.config.voxel_m, MIN_SIGMA_VOXELS**2)
        return remove_small_components(found, MIN_COMPONENT_TRIANGLES)

    def _depth_weights(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W) weight of each reading, 1 at best; 0 where there is none."""
        # What lies within a voxel is not told apart, however good the reading.
        best_m = MIN_SIGMA_VOXELS * self.config.voxel_m
        variance = best_m**2 + depth_sigma_m(depth_m.astype(np.float64)) ** 2
        return np.where(depth_m > 0, best_m**2 / variance, 0.0).astype(np.float32)
