"""Model of a depth camera with thirteen parameters."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, rigid_transform, so3_exp
from vo_service.tools.calibration.snapshot import Lens

PARAMETER_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "rx", "ry", "rz", "tx", "ty", "tz", "scale")
DISTORTION = slice(4, 6)
ROTATION = slice(6, 9)
TRANSLATION = slice(9, 12)
SCALE_INDEX = 12
# Kinect and Xtion: ratio of infrared focal length and image width; the color camera is 25 mm to
# the right of the infrared camera.
DEFAULT_FOCAL_RATIO = 575.8 / 640.0
DEFAULT_TRANSLATION_M = (-0.025, 0.0, 0.0)
# Brown's model has no closed inverse. For small distortion the error is far below a pixel.
UNDISTORT_ITERATIONS = 20


@dataclass(frozen=True)
class DepthModel:
    """Depth camera; `vector` (13,) has `PARAMETER_NAMES`, rotation as axis-angle (rad), meters."""

    vector: Array

    @classmethod
    def default(cls, size: tuple[int, int], scale: float) -> Self:
        """Return a typical Kinect's depth camera for an image size (width, height)."""
        width, height = size
        focal_px = DEFAULT_FOCAL_RATIO * width
        center = ((width - 1) / 2, (height - 1) / 2)
        no_distortion_no_rotation = [0.0] * 5
        return cls(
            np.array(
                [
                    focal_px,
                    focal_px,
                    *center,
                    *no_distortion_no_rotation,
                    *DEFAULT_TRANSLATION_M,
                    scale,
                ]
            )
        )

    def with_parameters(self, indices: NDArray[np.int64], values: Array) -> "DepthModel":
        """Return a copy with changed parameters; `indices` are positions in `vector`."""
        vector = self.vector.copy()
        vector[indices] = values
        return DepthModel(vector)

    @property
    def T_color_depth(self) -> Array:
        """4x4 transform from the depth camera's frame to the color camera's."""
        return rigid_transform(so3_exp(self.vector[ROTATION]), self.vector[TRANSLATION])

    @property
    def scale(self) -> float:
        """True distance divided by the reading."""
        return float(self.vector[SCALE_INDEX])

    @property
    def lens(self) -> Lens:
        """Intrinsics and distortion."""
        fx, fy, cx, cy, k1, k2 = (float(value) for value in self.vector[:6])
        return Lens(fx, fy, cx, cy, (k1, k2, 0.0, 0.0, 0.0))

    def points_m(self, pixels: Array, readings_m: Array) -> Array:
        """Return points (N, 3) in the color camera's frame of readings (N,) at pixels (N, 2)."""
        rays = self._rays(pixels)
        points = rays * (self.scale * readings_m)[:, None]
        T = self.T_color_depth
        points_color: Array = points @ T[:3, :3].T + T[:3, 3]
        return points_color

    def _rays(self, pixels: Array) -> Array:
        """Return undistorted rays (N, 3) with z = 1, by fixed-point iteration."""
        k1, k2 = self.vector[DISTORTION]
        distorted_x, distorted_y = ((pixels - self.vector[2:4]) / self.vector[0:2]).T
        x, y = distorted_x, distorted_y
        for _ in range(UNDISTORT_ITERATIONS if k1 or k2 else 0):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * k2)
            x, y = distorted_x / radial, distorted_y / radial
        return np.column_stack([x, y, np.ones(len(x))])
