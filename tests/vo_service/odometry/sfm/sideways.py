"""A camera that walks past a known scene, far enough for parallax within a few frames."""

from dataclasses import replace
from functools import cache

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, rigid_transform, rotation_from_vector
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from tests.vo_service.odometry.walk import SHAPE

# By the fourth frame the parallax of the first with the first reaches three degrees.
FIRST_PLACED = 4
FRAMES = 9


def pose(k: int) -> Array:
    """45 mm sideways and half a degree a frame."""
    return rigid_transform(
        rotation_from_vector([0.003 * k, -0.008 * k, 0.004 * k]), [0.045 * k, 0.0, 0.01 * k]
    )


@cache
def view(k: int) -> RgbdFrame:
    """The k-th frame."""
    return view_of_a_corner(pose(k), k)


def views(count: int = FRAMES) -> list[RgbdFrame]:
    """The first frames."""
    return [view(k) for k in range(count)]


def without_depth(frame: RgbdFrame) -> RgbdFrame:
    """The same picture, the depth camera covered."""
    return replace(frame, depth_raw=np.zeros(SHAPE, np.uint16))
