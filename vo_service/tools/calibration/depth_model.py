"""A depth camera as thirteen numbers."""

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
# Kinect and Xtion: infrared focal length over the image's width, and the color camera 25 mm to
# the right of the infrared one.
DEFAULT_FOCAL_RATIO = 575.8 / 640.0
DEFAULT_TRANSLATION_M = (-0.025, 0.0, 0.0)
# Brown's model has no inverse in closed form; for a mild lens this is far below a pixel.
UNDISTORT_ITERATIONS = 20


@dataclass(frozen=True)
class DepthModel:
    """vector (13,): `NAMES`, the turn as axis times angle (rad), the shift in metres."""

    vector: Array

    @classmethod
    def default(cls, size: tuple[int, int], scale: float) -> Self:
        """What a Kinect's depth camera is like, for an image of (width, height)."""
        width, height = size
        focal_px = DEFAULT_FOCAL_RATIO * width
        middle = ((width - 1) / 2, (height - 1) / 2)
        no_distortion_no_turn = [0.0] * 5
        return cls(
            np.array(
                [focal_px, focal_px, *middle, *no_distortion_no_turn, *DEFAULT_TRANSLATION_M, scale]
            )
        )

    def with_parameters(self, indices: NDArray[np.int64], values: Array) -> "DepthModel":
        """The same but for the parameters numbered `free`."""
        vector = self.vector.copy()
        vector[indices] = values
        return DepthModel(vector)

    @property
    def T_color_depth(self) -> Array:
        """4x4; maps depth camera coordinates to the color camera."""
        return rigid_transform(so3_exp(self.vector[ROTATION]), self.vector[TRANSLATION])

    @property
    def scale(self) -> float:
        """True distance per distance read."""
        return float(self.vector[SCALE_INDEX])

    @property
    def lens(self) -> Lens:
        """Intrinsics and distortion."""
        fx, fy, cx, cy, k1, k2 = (float(value) for value in self.vector[:6])
        return Lens(fx, fy, cx, cy, (k1, k2, 0.0, 0.0, 0.0))

    def points_m(self, pixels: Array, readings_m: Array) -> Array:
        """(N, 3) in the color camera, of readings (N,) at pixels (N, 2)."""
        rays = self._rays(pixels)
        points = rays * (self.scale * readings_m)[:, None]
        T = self.T_color_depth
        moved: Array = points @ T[:3, :3].T + T[:3, 3]
        return moved

    def _rays(self, pixels: Array) -> Array:
        """(N, 3) with z = 1: the distortion taken out, by fixed-point iteration."""
        k1, k2 = self.vector[DISTORTION]
        seen_x, seen_y = ((pixels - self.vector[2:4]) / self.vector[0:2]).T
        x, y = seen_x, seen_y
        for _ in range(UNDISTORT_ITERATIONS if k1 or k2 else 0):
            r2 = x * x + y * y
            bend = 1.0 + r2 * (k1 + r2 * k2)
            x, y = seen_x / bend, seen_y / bend
        return np.column_stack([x, y, np.ones(len(x))])
