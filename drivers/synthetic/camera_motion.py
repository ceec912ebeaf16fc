"""The motion of the camera: the exact pose of the color camera at any time.

The room's world is z up with its origin in the middle of the floor; the camera's axes are optical
(x right, y down, z forward).
"""

from abc import ABC, abstractmethod

import numpy as np

from drivers.core.geometry import Array


def cosine_ramp(progress: Array) -> Array:
    """Ramp from 0 to 1 while `progress` goes from 0 to 1, fastest in the middle."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(progress, 0.0, 1.0))


def smootherstep(progress: Array) -> Array:
    """Ramp as `cosine_ramp`, without a jump in the acceleration."""
    x = np.clip(progress, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def smootherstep_integral(progress: Array) -> Array:
    """Integral of `smootherstep` from far below 0 up to `progress`."""
    x = np.clip(progress, 0.0, 1.0)
    return x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(progress - 1.0, 0.0)


class CubicSpline:
    """Natural cubic spline through `values` (N, C) at strictly rising `knots` (N,), N >= 2.

    Outside the knots the end values are held.
    """

    def __init__(self, knots: Array, values: Array) -> None:
        self._knots = knots
        self._values = values
        self._second = _second_derivatives(knots, values)

    def __call__(self, times: Array) -> Array:
        """Values (M, C) at `times` (M,)."""
        knots, times = self._knots, np.clip(times, self._knots[0], self._knots[-1])
        i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        h = (knots[i + 1] - knots[i])[:, None]
        b = (times - knots[i])[:, None] / h
        a = 1.0 - b
        bend = (a**3 - a) * self._second[i] + (b**3 - b) * self._second[i + 1]
        return a * self._values[i] + b * self._values[i + 1] + bend * h**2 / 6.0


def _second_derivatives(knots: Array, values: Array) -> Array:
    """Solve the tridiagonal system of a natural spline by Thomas' algorithm, for all columns."""
    n = len(knots)
    h = np.diff(knots)
    slope = np.diff(values, axis=0) / h[:, None]
    rhs = 6.0 * np.diff(slope, axis=0)
    upper = np.zeros(n)
    second = np.zeros_like(values)
    for i in range(1, n - 1):
        pivot = 2.0 * (h[i - 1] + h[i]) - h[i - 1] * upper[i - 1]
        upper[i] = h[i] / pivot
        second[i] = (rhs[i - 1] - h[i - 1] * second[i - 1]) / pivot
    for i in range(n - 2, 0, -1):
        second[i] -= upper[i] * second[i + 1]
    return second


class CameraMotion(ABC):
    """The exact motion of the color camera."""

    @abstractmethod
    def poses(self, times_s: Array) -> Array:
        """T_world_camera (N, 4, 4) at `times_s` (N,), counted from the first frame's stamp."""

    def clearance_points_m(self, times_s: Array) -> Array:
        """World points (M, 3) that furniture must leave free: here the camera's positions."""
        return self.poses(times_s)[:, :3, 3]


def make_poses(position_m: Array, yaw: Array, down: Array, roll: Array) -> Array:
    """Make T_world_camera (N, 4, 4) from positions (N, 3) and the angles of `look_rotations`."""
    T = np.tile(np.eye(4), (len(position_m), 1, 1))
    T[:, :3, 3], T[:, :3, :3] = position_m, look_rotations(yaw, down, roll)
    return T


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


def rotate_yaw(T_world_camera: Array, yaw_rad: Array) -> Array:
    """Turn each pose (N, 4, 4) to the left about its own position, by its own angle (N,)."""
    zero = np.zeros_like(yaw_rad)
    result = T_world_camera.copy()
    turns = rotations_from_vectors(np.stack([zero, zero, yaw_rad], axis=1))
    result[:, :3, :3] = turns @ T_world_camera[:, :3, :3]
    return result
