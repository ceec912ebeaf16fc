"""A frame as structure from motion knows it: color alone."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.sfm.rolling_shutter import ShutterMotion
from vo_service.odometry.surf import Features

# A point is known, and may carry the scale, if its depth is as sure as this, relative.
MAX_RELATIVE_DEPTH_SIGMA = 0.2
# Standard deviation in pixels of where a feature is found again: of both images' errors together.
PAIR_SIGMA_PX = 0.7


@dataclass(frozen=True)
class MonoFrame:
    """What is kept of a frame.

    features  where they are in the image, and what they look like
    ray       (N, 3) the direction of each at the frame's instant, in the camera's axes, scaled to
              z = 1
    focal_px  of the camera, the mean of both directions
    stamp_s   of the frame
    seen      (N, 3) the direction of each when its row was read
    delay_s   (N,) how long after the frame's instant that was: all 0 with a global shutter
    """

    features: Features
    ray: Array
    focal_px: float
    stamp_s: float
    observed_ray: Array
    delay_s: Array

    @classmethod
    def from_features(cls, features: Features, frame: RgbdFrame) -> Self:
        """The features of a frame, whose depth is not looked at, as of a camera at rest."""
        camera = frame.camera
        u, v = features.position_px.astype(np.float64).T
        x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        ray = np.column_stack([x, y, np.ones(len(features))])
        delay_s = frame.readout_s * (v / max(camera.height - 1, 1) - 0.5)
        return cls(features, ray, (camera.fx + camera.fy) / 2.0, frame.stamp_s, ray, delay_s)

    @property
    def has_rolling_shutter(self) -> bool:
        """Whether the rows are of different instants."""
        return bool(self.delay_s.any())

    def compensate_rolling_shutter(self, shutter_motion: ShutterMotion) -> "MonoFrame":
        """The same features, of a camera that moves like this."""
        return (
            replace(self, ray=shutter_motion.undistort_rays(self.observed_ray, self.delay_s))
            if self.has_rolling_shutter
            else self
        )


@dataclass(frozen=True)
class RayPairs:
    """The same features seen by the camera and by the reference.

    ray            (M, 3) in the camera's axes, z = 1
    ray_reference  (M, 3) in the reference's axes, z = 1
    inverse_depth  (M,) 1/m in the reference; means nothing where the information is 0
    information    (M,) 1 / variance of the inverse depth, m^2; 0: not known
    sigma          standard deviation between a ray and where its point projects to, at z = 1
    """

    ray: Array
    ray_reference: Array
    inverse_depth: Array
    information: Array
    sigma: float

    def __len__(self) -> int:
        return len(self.ray)

    @property
    def has_known_depth(self) -> NDArray[np.bool_]:
        """(M,) bool: the depth is sure enough to carry the scale."""
        return is_depth_known(self.inverse_depth, self.information)

    def select(self, chosen: NDArray[np.bool_]) -> "RayPairs":
        """Those pairs of which `chosen` (M,) is True."""
        return RayPairs(
            self.ray[chosen],
            self.ray_reference[chosen],
            self.inverse_depth[chosen],
            self.information[chosen],
            self.sigma,
        )


def is_depth_known(inverse_depth: Array, information: Array) -> NDArray[np.bool_]:
    """(M,) bool: which depths are sure enough to carry the scale."""
    known: NDArray[np.bool_] = inverse_depth**2 * information > 1.0 / MAX_RELATIVE_DEPTH_SIGMA**2
    return known
