"""Overlap of a view with earlier views, by true poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, inverse, transform_points

# Stride of the grid of pixels that represents a view.
STEP_PX = 32
# A point is visible in another view if its depth there agrees within this distance.
MAX_SAME_DISTANCE_M = 0.10


@dataclass(frozen=True)
class ObservedView:
    """Points (N, 3) in the room at a grid of pixels, and the camera.

    `depth_m` is the whole image (H, W) as float16, 0 = no reading.
    """

    camera: PinholeCamera
    T_room_camera: Array
    points_m: Array
    depth_m: NDArray[np.float16]

    @classmethod
    def from_frame(cls, frame: RgbdFrame, T_room_camera: Array) -> "ObservedView":
        """Make the view of a frame with a known pose."""
        camera, half = frame.camera, STEP_PX // 2
        v, u = np.mgrid[half : camera.height : STEP_PX, half : camera.width : STEP_PX]
        z = frame.depth_m[v, u].astype(np.float64)
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(z)])
        points_m = (rays * z)[:, z > 0].T
        return cls(
            camera,
            T_room_camera,
            transform_points(T_room_camera, points_m),
            frame.depth_m.astype(np.float16),
        )

    def overlap_with(self, other: "ObservedView") -> float:
        """Fraction of the other view's points that are visible in this view."""
        if not len(other.points_m):
            return 0.0
        x, y, z = transform_points(inverse(self.T_room_camera), other.points_m).T
        ahead = np.maximum(z, 1e-6)
        u = np.rint(self.camera.fx * x / ahead + self.camera.cx).astype(int)
        v = np.rint(self.camera.fy * y / ahead + self.camera.cy).astype(int)
        height, width = self.depth_m.shape
        inside = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        there_m = self.depth_m[v[inside], u[inside]].astype(np.float64)
        is_same = (there_m > 0) & (np.abs(there_m - z[inside]) < MAX_SAME_DISTANCE_M)
        return float(np.count_nonzero(is_same)) / len(other.points_m)


def max_overlap(view: ObservedView, before: Sequence[ObservedView]) -> float:
    """Largest overlap of a view with one of the views before."""
    return max((one.overlap_with(view) for one in before), default=0.0)
