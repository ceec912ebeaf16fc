"""small_gicp, frame to frame, on depth alone: generalised ICP (Segal, Haehnel and Thrun 2009)."""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array

# Every so many-th pixel each way, thinned to one point a voxel; covariances from so many
# neighbours; pairs no further apart than this. Of those tried (2 and 4 pixels, 3 and 5 cm, 10 and
# 20 neighbours) the most accurate on a real and a rendered recording, at a middling cost.
PIXEL_STEP, VOXEL_M, COVARIANCE_NEIGHBORS, MAX_PAIR_DISTANCE_M = 4, 0.03, 20, 0.1
# Of its points, so many at least find a pair; else the frame has failed.
MIN_FITNESS = 0.3


class SmallGicp:
    """Generalised ICP on thinned clouds; see `PairwiseMethod`."""

    def __init__(self, small_gicp: ModuleType) -> None:
        self._gicp = small_gicp

    def prepare(self, frame: RgbdFrame) -> Any:
        """A thinned cloud with covariances, and its tree."""
        return self._gicp.preprocess_points(
            sample_points(frame),
            downsampling_resolution=VOXEL_M,
            num_neighbors=COVARIANCE_NEIGHBORS,
        )

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Distribution to distribution."""
        (target, tree), (source, _) = earlier, later
        if not (target.size() and source.size()):
            return None
        found = self._gicp.align(
            target,
            source,
            tree,
            T_earlier_later,
            registration_type="GICP",
            max_correspondence_distance=MAX_PAIR_DISTANCE_M,
        )
        good = found.converged and found.num_inliers >= MIN_FITNESS * source.size()
        return np.array(found.T_target_source, np.float64) if good else None


def sample_points(frame: RgbdFrame) -> NDArray[np.float64]:
    """(N, 3) points in the camera's axes, of every fourth pixel each way that has a reading."""
    camera = frame.camera
    z_m = frame.depth_m[::PIXEL_STEP, ::PIXEL_STEP].astype(np.float64)
    v, u = np.nonzero(z_m)
    z_m = z_m[v, u]
    x_m = (PIXEL_STEP * u - camera.cx) / camera.fx * z_m
    y_m = (PIXEL_STEP * v - camera.cy) / camera.fy * z_m
    return np.column_stack([x_m, y_m, z_m])
