"""Depth and colour of many frames, fused into one surface.

A truncated signed distance in voxels that exist only near surfaces, and only so many of them:
`blocks.py` keeps them, `integrate.py` fills them, `surface.py` makes the mesh.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.geometry import Array, inverse
from vo_service.mapping.blocks import BLOCK_BYTES, SIDE, Blocks
from vo_service.mapping.fusion_settings import FusionSettings
from vo_service.mapping.integrate import (
    blocks_in_view,
    integrate,
    sides_of_view,
    touched_blocks,
)
from vo_service.mapping.islands import without_islands
from vo_service.mapping.mesh import Mesh
from vo_service.mapping.surface import MESH_BYTES, surface
from vo_service.odometry.depth_noise import depth_sigma_m
from vo_service.settings import MEGABYTE

# A ray for at least every so many in the width of a block.
RAYS_ACROSS_BLOCK = 4.0
# Standard deviation of the best of readings. A surface is known well enough to be drawn when all
# readings of it together are as good as one voxel: a weight of BEST_VOXELS ** 2.
BEST_VOXELS = 0.5
# Smaller parts of the surface hang in the air by mistake: of 7 x 7 cells.
LEAST_TRIANGLES = 100


class Fusion:
    """A map that grows with every frame, up to a bound. Repeats bit for bit.

    Where the bound is reached, what is there already goes on being refined; what is new is left
    out, and `is_full` says so.
    """

    def __init__(self, settings: FusionSettings) -> None:
        """Raises MemoryError if the system refuses the memory."""
        self.settings = settings
        of_each = BLOCK_BYTES + MESH_BYTES
        self._blocks = Blocks(max(1, settings.memory_mb * MEGABYTE // of_each))

    @property
    def is_full(self) -> bool:
        """Whether something was left out for want of memory."""
        return self._blocks.refused > 0

    @property
    def share_used(self) -> float:
        """How much of the memory is used, 0 to 1."""
        return self._blocks.count / self._blocks.capacity

    def add(
        self,
        depth_m: NDArray[np.float32],
        colour_bgr: NDArray[np.uint8],
        camera: PinholeCamera,
        T_world_camera: Array,
    ) -> None:
        """Fuse one frame: depth (H, W) in metres, 0 = no reading, and colour (H, W, 3)."""
        blocks, settings = self._blocks, self.settings
        block_m = SIDE * settings.voxel_m
        focal_centre = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        T_camera_world = inverse(T_world_camera)
        near_m = np.where(depth_m <= settings.max_depth_m, depth_m, np.float32(0.0))
        # Room for what is seen.
        across_px = block_m / settings.max_depth_m * min(camera.fx, camera.fy)
        step_px = max(1, int(across_px / RAYS_ACROSS_BLOCK))
        blocks.make_room(
            touched_blocks(
                near_m, focal_centre, T_world_camera, block_m, settings.truncation_m, step_px
            )
        )
        # Every voxel in view, whether there is a surface or nothing.
        coordinates = blocks.coordinates[: blocks.count]
        reach_m = float(depth_m.max()) + settings.truncation_m
        seen = blocks_in_view(coordinates, sides_of_view(camera), T_camera_world, block_m, reach_m)
        integrate(
            seen,
            coordinates,
            (blocks.distance_m, blocks.weight, blocks.colour),
            (depth_m, self._weight(depth_m), colour_bgr),
            focal_centre,
            T_camera_world,
            settings.voxel_m,
            settings.truncation_m,
        )

    def has_depth(self, depth_m: NDArray[np.float32]) -> bool:
        """Whether there is anything in these readings to fuse."""
        return bool(np.any((depth_m > 0) & (depth_m <= self.settings.max_depth_m)))

    def mesh(self) -> Mesh:
        """The surface as far as it is known to a voxel, without specks."""
        found = surface(self._blocks, self.settings.voxel_m, BEST_VOXELS**2)
        return without_islands(found, LEAST_TRIANGLES)

    def _weight(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W) weight of each reading, 1 at best; 0 where there is none."""
        # What lies within a voxel is not told apart, however good the reading.
        best_m = BEST_VOXELS * self.settings.voxel_m
        variance = best_m**2 + depth_sigma_m(depth_m.astype(np.float64)) ** 2
        return np.where(depth_m > 0, best_m**2 / variance, 0.0).astype(np.float32)
