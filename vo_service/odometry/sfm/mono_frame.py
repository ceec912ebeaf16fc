"""A frame for structure from motion: features and rays, without depth.

Each row of a rolling shutter has its own time. At a constant velocity all rays can be transformed
to the time of the middle row. Hedborg, Forssén, Felsberg and Ringaby, "Rolling Shutter Bundle
Adjustment" (CVPR 2012) interpolate the poses of the rows in the same way.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, so3_log
from vo_service.odometry.features.extractor import Features


@dataclass(frozen=True)
class ShutterMotion:
    """Velocity of the camera in its own axes.

    Attributes:
        translation_per_s: (3,) linear velocity divided by the depth of the scene.
        angular_velocity_rad_s: (3,).
    """

    translation_per_s: Array = field(default_factory=lambda: np.zeros(3))
    angular_velocity_rad_s: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_motion(
        cls, T_before_after: Array, duration_s: float, inverse_depth: float
    ) -> "ShutterMotion":
        """Mean velocity over a motion, in the axes at its end; 0 for a duration of 0.

        Args:
            T_before_after: 4x4 motion.
            duration_s: Time of the motion.
            inverse_depth: Of the scene, 1/m.
        """
        if duration_s == 0.0:
            return cls()
        R, t_m = T_before_after[:3, :3], T_before_after[:3, 3]
        return cls(R.T @ t_m * (inverse_depth / duration_s), so3_log(R) / duration_s)

    def undistort_rays(self, ray: Array, delay_s: Array) -> Array:
        """Transform rays (N, 3), z = 1, observed after a delay (N,), to delay 0.

        The rotation is of second order: the error is hundredths of a pixel at 4 rad/s.
        """
        rotation_rad = delay_s[:, None] * self.angular_velocity_rad_s
        rotated = np.cross(rotation_rad, ray)
        moved = (
            ray
            + rotated
            + 0.5 * np.cross(rotation_rad, rotated)
            + delay_s[:, None] * self.translation_per_s
        )
        undistorted: Array = moved / moved[:, 2:]
        return undistorted


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
