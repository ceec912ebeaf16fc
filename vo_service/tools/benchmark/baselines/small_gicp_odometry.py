"""small_gicp, frame to frame, on depth only: generalized ICP (Segal, Haehnel and Thrun 2009)."""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array

# Pixel step, voxel size, neighbors for covariances, and maximum distance of a pair. Of those tried
# (2 and 4 pixels, 3 and 5 cm, 10 and 20 neighbors), these are the most accurate on a real and a
# rendered recording, at a medium cost.
PIXEL_STEP, VOXEL_M, COVARIANCE_NEIGHBORS, MAX_PAIR_DISTANCE_M = 4, 0.03, 20, 0.1
# Minimum fraction of points with a pair; otherwise the frame fails.
MIN_FITNESS = 0.3


class SmallGicp:
    """`PairwiseMethod` of generalized ICP on downsampled clouds."""

    def __init__(self, small_gicp: ModuleType) -> None:
        self._gicp = small_gicp

    def prepare(self, frame: RgbdFrame) -> Any:
        """Make a downsampled cloud with covariances, and its search tree."""
        return self._gicp.preprocess_points(
            sample_points(frame),
            downsampling_resolution=VOXEL_M,
            num_neighbors=COVARIANCE_NEIGHBORS,
        )

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Align two clouds, distribution to distribution."""
        (target, tree), (source, _) = earlier, later
        if not (target.size() and source.size()):
            return None
        result = self._gicp.align(
            target,
            source,
            tree,
            T_earlier_later,
            registration_type="GICP",
            max_correspondence_distance=MAX_PAIR_DISTANCE_M,
        )
        good = result.converged and result.num_inliers >= MIN_FITNESS * source.size()
        return np.array(result.T_target_source, np.float64) if good else None


def sample_points(frame: RgbdFrame) -> NDArray[np.float64]:
    """Return (N, 3) points in optical axes, m, of every fourth column and row with depth."""
    camera = frame.camera
    z_m = frame.depth_m[::PIXEL_STEP, ::PIXEL_STEP].astype(np.float64)
    v, u = np.nonzero(z_m)
    z_m = z_m[v, u]
    x_m = (PIXEL_STEP * u - camera.cx) / camera.fx * z_m
    y_m = (PIXEL_STEP * v - camera.cy) / camera.fy * z_m
    return np.column_stack([x_m, y_m, z_m])
