"""Leveling of a map: the up direction from gravity or from the motion."""

import numpy as np

from drivers.core.geometry import Array, Vector, rigid_transform
from vo_service.reconstruction.mesh import Mesh

# Half angles of the cones around the estimated up direction; normals of floors and tables are
# inside.
SEARCH_CONES_RAD = tuple(np.radians([30.0, 20.0, 10.0, 5.0]))
# Below this share of level surface, there is no floor to align with.
MIN_LEVEL_FRACTION = 0.02
# If the camera looks almost straight down, the top of its image defines forward.
MIN_FORWARD_NORM = 0.3


class UpDirectionEstimator:
    """Mean up direction in the world: from gravity if measured, else from the camera's y axis."""

    def __init__(self) -> None:
        self._sum_from_gravity, self._sum_from_camera_axes = np.zeros(3), np.zeros(3)

    def add(self, T_world_camera: Array, gravity_m_s2: Vector | None) -> None:
        """Add one frame.

        Args:
            T_world_camera: 4x4 pose.
            gravity_m_s2: (3,) measured gravity in camera axes; None without an accelerometer.
        """
        self._sum_from_camera_axes -= T_world_camera[:3, 1]
        if gravity_m_s2 is not None:
            self._sum_from_gravity -= T_world_camera[:3, :3] @ np.asarray(gravity_m_s2)

    @property
    def up(self) -> Array:
        """(3,) unit vector in the world."""
        direction = (
            self._sum_from_gravity if self._sum_from_gravity.any() else self._sum_from_camera_axes
        )
        length = float(np.linalg.norm(direction))
        return direction / length if length > 0.0 else np.array([0.0, -1.0, 0.0])


def estimate_up(mesh: Mesh, initial_up: Array) -> Array:
    """Refine the up direction with the normals of the level surfaces.

    Args:
        initial_up: (3,) unit vector, the initial guess.

    Returns:
        (3,) unit vector.
    """
    up = initial_up
    for cone_rad in SEARCH_CONES_RAD:
        is_level = mesh.normals @ up > np.cos(cone_rad)
        if np.count_nonzero(is_level) <= MIN_LEVEL_FRACTION * len(is_level):
            return up
        mean = mesh.normals[is_level].mean(axis=0, dtype=np.float64)
        up = mean / np.linalg.norm(mean)
    return up


def level_transform(T_world_camera: Array, up: Array) -> Array:
    """Compute the transform to level axes: x right and y forward of a camera, z up.

    Args:
        T_world_camera: 4x4 pose of the camera, which becomes the origin.
        up: (3,) unit vector in the world.

    Returns:
        T_level_world, 4x4.
    """
    optical_axis, image_top = T_world_camera[:3, 2], -T_world_camera[:3, 1]
    forward = optical_axis - up * (optical_axis @ up)
    if np.linalg.norm(forward) < MIN_FORWARD_NORM:
        forward = image_top - up * (image_top @ up)
    forward = forward / np.linalg.norm(forward)
    R = np.array([np.cross(forward, up), forward, up])
    return rigid_transform(R, -R @ T_world_camera[:3, 3])
