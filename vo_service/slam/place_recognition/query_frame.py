"""A frame prepared for place recognition."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.slam.place_recognition.depth_features import DepthFeatures

# Sigma of the camera's velocity, m/s and rad/s: if the odometry tracked the frame, and if it was
# lost.
TRACKED_VELOCITY_SIGMA, LOST_VELOCITY_SIGMA = (0.01, 0.03), (0.3, 1.0)


@dataclass(frozen=True, eq=False)
class QueryFrame:
    """A frame to be recognized, or to become a keyframe.

    Attributes:
        features: In the camera's axes at the stamp.
        vlad_descriptor: (D,) int8, see `VladVocabulary`.
        image_pyramid: For the dense alignment.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
        velocity_sigma: Of the velocity, m/s and rad/s.
    """

    features: DepthFeatures
    vlad_descriptor: NDArray[np.int8]
    image_pyramid: ImagePyramid
    velocity: Array
    velocity_sigma: tuple[float, float]

    @property
    def stamp_s(self) -> float:
        """Stamp of the frame."""
        return self.image_pyramid.stamp_s

    @property
    def camera(self) -> PinholeCamera:
        """Intrinsics of the frame."""
        return self.image_pyramid.camera
