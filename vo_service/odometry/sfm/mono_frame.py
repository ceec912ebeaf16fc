"""A frame for structure from motion: features and rays, without depth."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.sfm.rolling_shutter import ShutterMotion
from vo_service.odometry.surf import Features

# Largest relative sigma of a known depth, which may determine the scale.
MAX_RELATIVE_DEPTH_SIGMA = 0.2
# Standard deviation of a matched feature's position, by the errors of both images.
PAIR_SIGMA_PX = 0.7


@dataclass(frozen=True)
class MonoFrame:
    """Features and rays of a frame.

    Attributes:
        features: Positions in the image and descriptors.
        ray: (N, 3) direction of each feature at the frame's stamp, in the camera's axes, scaled to
            z = 1.
        focal_px: Focal length of the camera, the mean of both directions.
        stamp_s: Of the frame.
        observed_ray: (N, 3) direction of each feature at the time of its row.
        delay_s: (N,) time of the row after the stamp; 0 with a global shutter.
    """

    features: Features
    ray: Array
    focal_px: float
    stamp_s: float
    observed_ray: Array
    delay_s: Array

    @classmethod
    def from_features(cls, features: Features, frame: RgbdFrame) -> Self:
        """Make the rays of a frame's features, for a camera at rest; the depth is not used."""
        camera = frame.camera
        u, v = features.position_px.astype(np.float64).T
        x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        ray = np.column_stack([x, y, np.ones(len(features))])
        delay_s = frame.readout_s * (v / max(camera.height - 1, 1) - 0.5)
        return cls(features, ray, (camera.fx + camera.fy) / 2.0, frame.stamp_s, ray, delay_s)

    @property
    def has_rolling_shutter(self) -> bool:
        """Whether the rows have different times."""
        return bool(self.delay_s.any())

    def compensate_rolling_shutter(self, shutter_motion: ShutterMotion) -> "MonoFrame":
        """Return a copy with the rays of a camera with this motion."""
        return (
            replace(self, ray=shutter_motion.undistort_rays(self.observed_ray, self.delay_s))
            if self.has_rolling_shutter
            else self
        )


@dataclass(frozen=True)
class RayPairs:
    """Rays of matched features in the camera and in the reference.

    Attributes:
        ray: (M, 3) in the camera's axes, z = 1.
        ray_reference: (M, 3) in the reference's axes, z = 1.
        inverse_depth: (M,) 1/m in the reference; undefined where the information is 0.
        information: (M,) 1 / variance of the inverse depth, m^2; 0 for unknown.
        sigma: Standard deviation between a ray and its point's projection, at z = 1.
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
        """(M,) bool: whether the depth is accurate enough for the scale."""
        return is_depth_known(self.inverse_depth, self.information)

    def select(self, chosen: NDArray[np.bool_]) -> "RayPairs":
        """Select the pairs where `chosen` (M,) is True."""
        return RayPairs(
            self.ray[chosen],
            self.ray_reference[chosen],
            self.inverse_depth[chosen],
            self.information[chosen],
            self.sigma,
        )


def is_depth_known(inverse_depth: Array, information: Array) -> NDArray[np.bool_]:
    """(M,) bool: whether depths are accurate enough for the scale."""
    known: NDArray[np.bool_] = inverse_depth**2 * information > 1.0 / MAX_RELATIVE_DEPTH_SIGMA**2
    return known
