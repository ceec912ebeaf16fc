"""How much of what one view shows was seen in others before, by true poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, inverse, transform_points

# A grid of pixels stands for the view.
STEP_PX = 32
# What another view shows less than so far from a point is that point.
MAX_SAME_DISTANCE_M = 0.10


@dataclass(frozen=True)
class ObservedView:
    """What was seen at pixels of a grid: points (N, 3) of the room, and from where.

    depth_m  (H, W) float16 of the whole image, 0 where nothing was read
    """

    camera: PinholeCamera
    T_room_camera: Array
    points_m: Array
    depth_m: NDArray[np.float16]

    @classmethod
    def from_frame(cls, frame: RgbdFrame, T_room_camera: Array) -> "ObservedView":
        """What a frame with a known pose shows."""
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
        """0 to 1: how much of what the other view shows is seen here."""
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
    """The largest share of a view that one of those before it shows as well."""
    return max((one.overlap_with(view) for one in before), default=0.0)
