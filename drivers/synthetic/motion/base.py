"""The motion of the camera: the exact pose of the color camera at any time.

The room's world is z up with its origin in the middle of the floor; the camera's axes are optical
(x right, y down, z forward).
"""

from abc import ABC, abstractmethod

import numpy as np

from drivers.core.geometry import Array


class CameraMotion(ABC):
    """The exact motion of the color camera."""

    @abstractmethod
    def poses(self, times_s: Array) -> Array:
        """T_world_camera (N, 4, 4) at `times_s` (N,), counted from the first frame's stamp."""

    def clearance_points_m(self, times_s: Array) -> Array:
        """World points (M, 3) that furniture must leave free: here the camera's positions."""
        result: Array = self.poses(times_s)[:, :3, 3]
        return result


def look_rotations(yaw: Array, down: Array, roll: Array) -> Array:
    """Rotations of a camera that looks along +y, then is turned left, down and rolled.

    Args:
        yaw: Angles (N,) to the left, in radians.
        down: Angles (N,) downward.
        roll: Angles (N,) about the optical axis.

    Returns:
        R_world_camera (N, 3, 3).
    """
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    zero = np.zeros_like(yaw)
    turn = rotations_from_vectors(np.stack([zero, zero, yaw], axis=1))
    pitch = rotations_from_vectors(np.stack([-down, zero, zero], axis=1))
    tilt = rotations_from_vectors(np.stack([zero, zero, roll], axis=1))
    result: Array = turn @ level @ pitch @ tilt
    return result


def rotations_from_vectors(vectors_rad: Array) -> Array:
    """Convert rotation vectors (N, 3) to matrices (N, 3, 3) by Rodrigues' formula."""
    x, y, z = vectors_rad.T
    zero = np.zeros_like(x)
    K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    angle = np.linalg.norm(vectors_rad, axis=1)[:, None, None]
    sine, cosine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    result: Array = np.eye(3) + sine * K + cosine * (K @ K)
    return result
