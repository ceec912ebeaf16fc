"""A frame as a map looks at it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.slam.place_recognition.depth_features import DepthFeatures

# How well the camera's velocity is known, m/s and rad/s: where the odometry followed it up to this
# frame, and where it was lost.
TRACKED_VELOCITY_SIGMA, LOST_VELOCITY_SIGMA = (0.01, 0.03), (0.3, 1.0)


@dataclass(frozen=True, eq=False)
class QueryFrame:
    """What is made of a frame to know its place again, or to make a place of it.

    landmarks  in the camera's axes at the stamp
    summary    (D,) int8, see `words`
    images     for the dense alignment
    velocity   (6,) twist of the camera in its own axes, m/s and rad/s
    known_to   how well the velocity is known, m/s and rad/s
    """

    features: DepthFeatures
    vlad_descriptor: NDArray[np.int8]
    image_pyramid: ImagePyramid
    velocity: Array
    velocity_sigma: tuple[float, float]

    @property
    def stamp_s(self) -> float:
        """Of the frame."""
        return self.image_pyramid.stamp_s

    @property
    def camera(self) -> PinholeCamera:
        """Intrinsics of the frame."""
        return self.image_pyramid.camera
