"""The camera in a level frame: the point on the floor below it, x forward, y left, z up."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, so3_log

# Below this length of its horizontal part, a direction has no yaw.
_MIN_HORIZONTAL = 1e-3


@dataclass(frozen=True)
class LevelView:
    """The camera in its level frame.

    Attributes:
        R_level_camera: 3x3, from optical axes to the level frame.
        height_m: Height of the camera above the floor.
    """

    R_level_camera: Array
    height_m: float

    def is_near(self, other: "LevelView", max_angle_rad: float) -> bool:
        """Whether the rotations differ by at most an angle."""
        step = so3_log(self.R_level_camera.T @ other.R_level_camera)
        return bool(np.linalg.norm(step) <= max_angle_rad)


class LevelMounting:
    """The camera on a base that stands on the floor; z of the base's origin is 0 there.

    Args:
        T_base_camera: 4x4 pose of the optical camera in the base.
    """

    def __init__(self, T_base_camera: Array) -> None:
        self._T_base_camera, self._T_camera_base = T_base_camera, inverse(T_base_camera)
        forward = T_base_camera[:3, 2]
        if np.hypot(*forward[:2]) < _MIN_HORIZONTAL:  # it looks straight down or up
            forward = -np.sign(forward[2]) * -T_base_camera[:3, 1]
        self._yaw_base_camera = float(np.arctan2(forward[1], forward[0]))

    @property
    def height_m(self) -> float:
        """Height of the camera on a level base."""
        return float(self._T_base_camera[2, 3])

    def T_base_level(self, z_m: float) -> Array:
        """4x4 pose of the camera's level frame in a level base, moved up to a height."""
        x, y = self._T_base_camera[:2, 3]
        return rigid_transform(_yaw_rotation(self._yaw_base_camera), (x, y, z_m))

    def view(self, T_odom_camera: Array) -> LevelView:
        """Return the view at a pose of the optical camera; z of `odom` is 0 on the floor."""
        yaw_odom_base = yaw_rad(T_odom_camera[:3, :3] @ self._T_camera_base[:3, :3])
        R_level_odom = _yaw_rotation(-(yaw_odom_base + self._yaw_base_camera))
        return LevelView(R_level_odom @ T_odom_camera[:3, :3], float(T_odom_camera[2, 3]))

    def planar_pose(self, T_map_camera: Array) -> Array:
        """(3,) x, y (meters) and yaw (radians) of the camera's level frame in the map."""
        T_map_base = T_map_camera @ self._T_camera_base
        yaw = yaw_rad(T_map_base[:3, :3]) + self._yaw_base_camera
        return np.array([T_map_camera[0, 3], T_map_camera[1, 3], yaw])


def yaw_rad(R: Array) -> float:
    """Return the yaw of the x axis of a rotation."""
    return float(np.arctan2(R[1, 0], R[0, 0]))


def _yaw_rotation(angle_rad: float) -> Array:
    return so3_exp(np.array([0.0, 0.0, angle_rad]))
