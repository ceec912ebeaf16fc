"""What can be set of a map. Imports no kernels: the command line shows the defaults."""

from dataclasses import dataclass

# How far around a surface the distance to it is kept. Less, and a surface that was seen twice, by
# poses some centimetres apart, would not become one.
MIN_TRUNCATION_VOXELS, MIN_TRUNCATION_M = 4.0, 0.06


@dataclass(frozen=True)
class TsdfConfig:
    """How fine a map is, and how much it may take.

    voxel_m      edge of a voxel: the finest detail
    memory_mb    for everything, the making of the mesh included
    max_depth_m  surfaces further from the camera are left out: too coarse
    """

    voxel_m: float = 0.01
    memory_mb: int = 1000
    max_depth_m: float = 4.0

    @property
    def truncation_m(self) -> float:
        """How far around a surface the distance to it is kept."""
        return max(MIN_TRUNCATION_VOXELS * self.voxel_m, MIN_TRUNCATION_M)
