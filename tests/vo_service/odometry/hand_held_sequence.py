"""A short hand-held sequence of a known scene, and its estimates."""

from collections.abc import Iterable

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, rotation_angle_rad, so3_exp
from tests.vo_service.odometry.synthetic_views import CAMERA, make_frame, render_corner
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry

SHAPE = (CAMERA.height, CAMERA.width)
BLACK = make_frame(np.zeros(SHAPE, np.uint8), np.full(SHAPE, 1.5))


def hand_held_poses(n: int) -> list[Array]:
    """Poses of a hand-held camera: 15 mm and 0.8 degrees a frame."""
    turn, shift = np.array([0.006, -0.010, 0.008]), np.array([0.010, -0.005, 0.011])
    return [rigid_transform(so3_exp(k * turn), k * shift) for k in range(n)]


def render_elsewhere(seq: int) -> RgbdFrame:
    """Render the corner from a pose without overlap with the other views."""
    away = rigid_transform(so3_exp([0.0, 0.7, 0.0]), [1.6, -0.3, 0.2])
    return render_corner(away @ hand_held_poses(seq + 1)[seq], seq)


def estimate_all(odometry: Odometry, frames: Iterable[RgbdFrame]) -> list[Estimate]:
    """Estimate all frames."""
    return [odometry.estimate(frame) for frame in frames]


def assert_close(T: Array, expected: Array, meters: float, degrees: float) -> None:
    """Check that two poses differ by less than these meters and degrees."""
    error = inverse(T) @ expected
    assert np.linalg.norm(error[:3, 3]) < meters
    assert np.degrees(rotation_angle_rad(error[:3, :3])) < degrees
