"""Settings of a map. Imports no kernels, as the command line shows the defaults."""

from dataclasses import dataclass

# Lower bounds of the truncation distance. A smaller one would not merge a surface that was seen
# twice with a pose error of some centimeters.
MIN_TRUNCATION_VOXELS, MIN_TRUNCATION_M = 4.0, 0.06


@dataclass(frozen=True)
class TsdfConfig:
    """Resolution and limits of a map.

    Attributes:
        voxel_m: Edge of a voxel, the finest detail.
        memory_mb: Memory limit, including mesh extraction.
        max_depth_m: Greater depths are ignored, as they are too coarse.
    """

    voxel_m: float = 0.01
    memory_mb: int = 1000
    max_depth_m: float = 4.0

    @property
    def truncation_m(self) -> float:
        """Distance from a surface up to which the signed distance is stored."""
        return max(MIN_TRUNCATION_VOXELS * self.voxel_m, MIN_TRUNCATION_M)
