"""A frame without its color: what a keyframe keeps of it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame


@dataclass(frozen=True)
class GrayFrame:
    """What features are found in and located with: a third of a frame's memory.

    gray          (height, width) uint8 brightness
    depth_raw     (height, width) uint16 as the sensor gave it, 0 = no reading
    depth_factor  value of `depth_raw` per metre
    """

    gray: NDArray[np.uint8]
    depth_raw: NDArray[np.uint16]
    depth_factor: float
    camera: PinholeCamera
    stamp_s: float

    @classmethod
    def of(cls, frame: "RgbdFrame | GrayFrame") -> Self:
        """Share the images of `frame`, but for its color."""
        return cls(frame.gray, frame.depth_raw, frame.depth_factor, frame.camera, frame.stamp_s)

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 metres; 0 = no reading. Not kept: it is needed once."""
        return self.depth_raw * np.float32(1.0 / self.depth_factor)
