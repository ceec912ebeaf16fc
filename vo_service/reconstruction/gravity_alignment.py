"""Which way is up in a map, and how the map lies level."""

import numpy as np

from drivers.core.geometry import Array, rigid_transform
from drivers.core.gravity import Vector
from vo_service.reconstruction.mesh import Mesh

# Floors and tables are sought this far from where up is thought to be, then ever closer.
SEARCH_CONES_RAD = tuple(np.radians([30.0, 20.0, 10.0, 5.0]))
# What faces up must be so much of the surface; else there is no floor in it.
MIN_LEVEL_FRACTION = 0.02
# A camera that looks straighter down than this has no forward; the top of its image has.
MIN_FORWARD_NORM = 0.3


class UpDirectionEstimator:
    """Up in the world: against gravity where it is measured, else as the camera is mostly held."""

    def __init__(self) -> None:
        self._sum_from_gravity, self._sum_from_camera_axes = np.zeros(3), np.zeros(3)

    def add(self, T_world_camera: Array, gravity_m_s2: Vector | None) -> None:
        """Take one frame into account."""
        self._sum_from_camera_axes -= T_world_camera[:3, 1]
        if gravity_m_s2 is not None:
            self._sum_from_gravity -= T_world_camera[:3, :3] @ np.asarray(gravity_m_s2)

    @property
    def up(self) -> Array:
        """(3,) of length 1, in the world."""
        measured = (
            self._sum_from_gravity if self._sum_from_gravity.any() else self._sum_from_camera_axes
        )
        length = float(np.linalg.norm(measured))
        return measured / length if length > 0.0 else np.array([0.0, -1.0, 0.0])


def estimate_up(mesh: Mesh, initial_up: Array) -> Array:
    """(3,) of length 1: what most of the level surfaces near the guess agree on."""
    up = initial_up
    for cone_rad in SEARCH_CONES_RAD:
        is_level = mesh.normals @ up > np.cos(cone_rad)
        if np.count_nonzero(is_level) <= MIN_LEVEL_FRACTION * len(is_level):
            return up
        mean = mesh.normals[is_level].mean(axis=0, dtype=np.float64)
        up = mean / np.linalg.norm(mean)
    return up


def level_transform(T_world_camera: Array, up: Array) -> Array:
    """T_level_world: x right and y forward as seen from this camera, z up, the camera at 0."""
    looking, top = T_world_camera[:3, 2], -T_world_camera[:3, 1]
    forward = looking - up * (looking @ up)
    if np.linalg.norm(forward) < MIN_FORWARD_NORM:
        forward = top - up * (top @ up)
    forward = forward / np.linalg.norm(forward)
    R = np.array([np.cross(forward, up), forward, up])
    return rigid_transform(R, -R @ T_world_camera[:3, 3])
