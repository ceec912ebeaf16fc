"""Coarse depth images, and whether a motion between two of them contradicts their free space.

A surface that the other camera saw through contradicts the motion; one that lies behind what the
other camera saw is occluded and does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.depth_planes import MAX_STEP_PER_M

# Distance of the readings, pixels.
GRID_STEP_PX = 16
# Errors beyond the depth's noise: a neighboring reading is looked up on an inclined surface.
MARGIN_M = 0.01


@dataclass(frozen=True)
class DepthGrid:
    """Every 16th depth reading of a row, and of a column.

    Attributes:
        depth_m: (h, w) float32; 0 = no reading.
        intrinsics: (4,) fx, fy, cx, cy in steps of the grid.
    """

    depth_m: NDArray[np.float32]
    intrinsics: Array

    @classmethod
    def of(cls, depth_m: NDArray[np.float32], camera: PinholeCamera) -> "DepthGrid":
        """Sample a depth image (H, W)."""
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy]) / GRID_STEP_PX
        return cls(depth_m[::GRID_STEP_PX, ::GRID_STEP_PX].copy(), intrinsics)

    def contradiction(self, other: "DepthGrid", T_other_self: Array) -> float:
        """Share of the readings visible to both cameras that one of them saw through, 0 to 1.

        It is the larger share of both directions, and 0 if nothing is visible to both.

        Args:
            other: Depth of the same sensor at another pose.
            T_other_self: 4x4 motion.
        """
        return max(
            _seen_through(first.depth_m, second.depth_m, self.intrinsics, np.ascontiguousarray(T))
            for first, second, T in (
                (self, other, T_other_self),
                (other, self, inverse(T_other_self)),
            )
        )


# The depth of a view that contradicts no motion.
NO_DEPTH = DepthGrid(np.empty((0, 0), np.float32), np.ones(4))


@kernel
def _seen_through(
    depth_m: NDArray[np.float32], other_m: NDArray[np.float32], intrinsics: Array, T: Array
) -> float:
    """Share of the readings, among those visible in the other grid, that it saw through.

    Args:
        depth_m: (h, w) readings.
        other_m: (h, w) readings of the other camera.
        intrinsics: (4,) fx, fy, cx, cy in steps of the grid.
        T: 4x4 motion to the other camera.
    """
    fx, fy, cx, cy = intrinsics
    height, width = other_m.shape
    visible = seen_through = 0
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            z = float(depth_m[row, column])
            x, y = (column - cx) / fx * z, (row - cy) / fy * z
            expected_m = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            if z <= 0.0 or expected_m <= 0.0:
                continue
            u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / expected_m + cx + 0.5
            v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / expected_m + cy + 0.5
            if not (0.0 <= u < width and 0.0 <= v < height):
                continue
            behind_m = float(other_m[int(v), int(u)]) - expected_m
            tolerance_m = MAX_STEP_PER_M * expected_m * expected_m + MARGIN_M
            # No reading is zero and counts as occluded.
            visible += 1 if behind_m >= -tolerance_m and behind_m > -expected_m else 0
            seen_through += 1 if behind_m > tolerance_m else 0
    return seen_through / max(visible, 1)
