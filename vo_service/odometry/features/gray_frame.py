"""Brightness and depth of a frame, for features."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame


@dataclass(frozen=True)
class GrayFrame:
    """Brightness and depth of a frame, for features; it needs a third of the frame's memory.

    Attributes:
        gray: (height, width) uint8 brightness.
        depth_raw: (height, width) uint16 as given by the sensor, 0 = no reading.
        depth_factor: Value of `depth_raw` per meter.
        camera: Intrinsics of both images.
        stamp_s: Of the frame.
    """

    gray: NDArray[np.uint8]
    depth_raw: NDArray[np.uint16]
    depth_factor: float
    camera: PinholeCamera
    stamp_s: float

    @classmethod
    def of(cls, frame: "RgbdFrame | GrayFrame") -> Self:
        """Share the images of `frame`, except its color."""
        return cls(frame.gray, frame.depth_raw, frame.depth_factor, frame.camera, frame.stamp_s)

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 meters; 0 = no reading. Not cached: it is needed once."""
        return self.depth_raw * np.float32(1.0 / self.depth_factor)
